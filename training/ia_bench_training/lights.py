"""Procedural lights: a small lat-long map of smooth light, and discs (sun, lamps) that are sampled and seen exactly.

Directions as in :mod:`ia_bench.light.latlong`: +z is up. Radiance is relative; the renderer scales it to its exposure.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench_training.draws import about_z, direction_of, log_uniform, pick
from ia_bench_training.noise import FIRST, fractal

HEIGHT, WIDTH = 64, 128
MAX_DISCS = 4
CASTS, CAST_SHARES = (0.06, 0.3, 0.6), (0.4, 0.4, 0.2)
"""Spreads of a light's cast, and how frequent each is: nearly white, clearly tinted, and as strong as lamps and sunsets."""


@dataclass(frozen=True)
class Light:
    """A lat-long map and D discs on top of it. A disc that is not there has cosine 2, so that nothing lies inside.

    Attributes:
        radiance: (H, W, 3), of the map.
        direction: (D, 3), unit, toward the discs.
        cosine: (D,), of the discs' angular radius.
        emission: (D, 3), the radiance that the discs add.
    """

    radiance: Tensor
    direction: Tensor
    cosine: Tensor
    emission: Tensor


class _Canvas:
    """A light under construction."""

    def __init__(self, rng: Generator) -> None:
        self.rng = rng
        self.map = torch.zeros(HEIGHT, WIDTH, 3)
        self.discs: list[tuple[np.ndarray, float, np.ndarray]] = []

    def disc(self, direction: np.ndarray, radius: float, irradiance: np.ndarray) -> None:
        """Add a disc of angular ``radius`` (radians) that gives ``irradiance`` (3,) to a surface facing it."""
        if len(self.discs) < MAX_DISCS:
            area = 2 * math.pi * (1 - math.cos(radius))
            self.discs.append((direction, math.cos(radius), irradiance / area))


@functools.cache
def _directions() -> Tensor:
    return texel_centres(HEIGHT, WIDTH)


def _colour(rng: Generator, spread: float) -> np.ndarray:
    """A tint of mean 1: ``spread`` 0.1 is mild, 0.6 strong. Most lie on the axis from warm to cool."""
    warm = rng.normal(0, spread) * np.array([1, 0.1, -1]) + rng.normal(0, 0.25 * spread) * np.array([-0.5, 1, -0.5])
    tint = np.exp(warm)
    return tint / tint.mean()


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))


def _mottle(rng: Generator, frequency: np.ndarray, octaves: int) -> Tensor:
    """Fractal noise over the directions of the map, (H, W, 1)."""
    at = _directions() * _tensor(frequency) + float(rng.uniform(0, 30))
    return fractal(at.reshape(-1, 3), octaves, channels=FIRST).reshape(HEIGHT, WIDTH, 1)


def _ground(canvas: _Canvas, up_irradiance: Tensor) -> None:
    """Fill the lower half with a ground that reflects what falls on it."""
    rng = canvas.rng
    albedo = _tensor(rng.uniform(0.05, 0.5) * _colour(rng, 0.25))
    z = _directions()[..., 2:]
    soft = (0.5 - z * rng.uniform(4, 30)).clamp(0, 1)
    spots = torch.exp(0.3 * _mottle(rng, np.array([2.0, 2.0, 2.0]), 3))
    canvas.map = canvas.map * (1 - soft) + soft * albedo * up_irradiance / math.pi * spots


def _upward(canvas: _Canvas) -> Tensor:
    """Irradiance (3,) of a floor under the map and its discs."""
    area = row_solid_angles(HEIGHT, WIDTH).float()[:, None, None]
    total = (canvas.map * _directions()[..., 2:].clamp_min(0) * area).sum((0, 1))
    for direction, cosine, emission in canvas.discs:
        total = total + _tensor(emission * 2 * math.pi * (1 - cosine) * max(direction[2], 0.0))
    return total


def sky(canvas: _Canvas) -> None:
    """Clear or hazy sky over ground, with a sun whose size stands for how veiled it is."""
    rng, d = canvas.rng, _directions()
    low_sun = rng.random() < 0.4  # dawn and dusk: the strongest colours that daylight has
    elevation, azimuth = math.radians(rng.uniform(2, 20) if low_sun else rng.uniform(10, 80)), rng.uniform(0, 2 * math.pi)
    toward = direction_of(elevation, azimuth)
    low = math.exp(-elevation * 4)  # red near the horizon
    zenith = np.array([0.25, 0.45, 1.0]) ** rng.uniform(0.3, 1.3)
    horizon = np.array([0.8, 0.9, 1.0]) ** rng.uniform(0, 1) * rng.uniform(0.8, 2.2)
    height = d[..., 2:].clamp_min(0)
    blend = torch.exp(-height * rng.uniform(1.5, 6))
    canvas.map = _tensor(zenith) * (1 - blend) + _tensor(horizon) * blend
    near = (d @ _tensor(toward))[..., None]
    sun = np.array([1.0, 0.92 - 0.35 * low, 0.82 - 0.65 * low])
    glow = torch.exp((near - 1) * rng.uniform(3, 60)) * rng.uniform(0, 4)
    canvas.map = canvas.map + glow * _tensor(sun)
    if rng.random() < 0.5:
        cover = 0.6 * torch.sigmoid(3 * _mottle(rng, np.array([1.5, 1.5, 4.0]), 4))
        canvas.map = canvas.map * (1 - cover) + rng.uniform(0.5, 2) * cover
    if rng.random() < 0.85:
        radius = math.radians(log_uniform(rng, 0.4, 8))
        canvas.disc(toward, radius, sun * log_uniform(rng, 1.5, 20))
    _ground(canvas, _upward(canvas))


def overcast(canvas: _Canvas) -> None:
    """Thick, mottled cloud that is brightest above."""
    rng, d = canvas.rng, _directions()
    bright = 1 + rng.uniform(0.5, 3) * d[..., 2:].clamp_min(0)
    canvas.map = bright * torch.exp(rng.uniform(0, 0.5) * _mottle(rng, np.array([1.5, 1.5, 1.5]), 3)) * _tensor(_colour(rng, 0.1))
    _ground(canvas, _upward(canvas))


def _box_light(canvas: _Canvas, toward: np.ndarray, half: tuple[float, float], radiance: np.ndarray, soft: float) -> None:
    """A rectangle of light facing the object; ``half`` sizes are tangents of its half angles."""
    side = np.cross([0, 0, 1], toward)
    side = side / max(float(np.linalg.norm(side)), 1e-6)
    up = np.cross(toward, side)
    spin = canvas.rng.normal(0, 0.15)
    side, up = math.cos(spin) * side + math.sin(spin) * up, math.cos(spin) * up - math.sin(spin) * side
    d = _directions()
    depth = d @ _tensor(toward)
    x, y = (d @ _tensor(side)) / depth.clamp_min(1e-3), (d @ _tensor(up)) / depth.clamp_min(1e-3)
    edge = torch.minimum(half[0] - x.abs(), half[1] - y.abs())
    inside = ((edge / soft) + 0.5).clamp(0, 1) * (depth > 0.01)
    canvas.map = canvas.map + inside[..., None] * _tensor(radiance)


def studio(canvas: _Canvas) -> None:
    """Soft boxes and strips around the object in a dim room."""
    rng = canvas.rng
    dim = rng.uniform(0.02, 0.5)
    canvas.map = dim * _tensor(_colour(rng, 0.1)) * (1 + 0.5 * _directions()[..., 2:])
    azimuth, colour = rng.uniform(0, 6.3), _colour(rng, 0.12)
    for k in range(int(rng.integers(1, 5))):
        toward = direction_of(math.radians(rng.uniform(-5, 85)), azimuth + k * rng.uniform(1.2, 2.6))
        half = (float(rng.uniform(0.12, 0.7)), float(rng.uniform(0.12, 0.7)))
        power = rng.uniform(1, 6) / (half[0] * half[1]) * (1 if k == 0 else rng.uniform(0.05, 0.6))
        _box_light(canvas, toward, half, power * (colour if rng.random() < 0.5 else _colour(rng, 0.4)), 0.06)


def room(canvas: _Canvas) -> None:
    """A room with differently coloured walls, lit through windows and perhaps by a lamp."""
    rng, d = canvas.rng, _directions()
    turn = rng.uniform(0, 6.3)
    q = d @ _tensor(about_z(turn))
    weight = torch.cat([q.clamp_min(0), (-q).clamp_min(0)], -1) ** 6
    weight = weight / weight.sum(-1, keepdim=True)
    walls = np.stack([rng.uniform(0.1, 0.9) * _colour(rng, 0.2) for _ in range(6)]) * _colour(rng, 0.1)
    canvas.map = (weight @ _tensor(walls)) * rng.uniform(0.15, 0.7)
    day = _colour(rng, 0.3) * rng.uniform(6, 40)
    for k in range(int(rng.integers(1, 4))):
        elevation, wall = math.radians(rng.uniform(-5, 45)), (math.pi / 2) * int(rng.integers(0, 4))
        toward = direction_of(elevation, turn + wall + rng.normal(0, 0.25))
        _box_light(canvas, toward, (float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.15, 0.6))), day, 0.05)
        if k == 0 and rng.random() < 0.3:
            canvas.disc(toward, math.radians(rng.uniform(0.5, 2)), _colour(rng, 0.2) * rng.uniform(1, 8))
    if rng.random() < 0.4:
        toward, radius = direction_of(rng.uniform(0.2, 1.5), rng.uniform(0, 6.3)), math.radians(rng.uniform(2, 8))
        canvas.disc(toward, radius, _colour(rng, 0.4) * rng.uniform(0.5, 4))


def lamps(canvas: _Canvas) -> None:
    """Lamps in the dark, often coloured."""
    rng, d = canvas.rng, _directions()
    canvas.map = rng.uniform(0.02, 0.3) * _tensor(_colour(rng, 0.2)) * (1 + rng.uniform(-0.5, 0.8) * d[..., 2:])
    spread = 0.6 if rng.random() < 0.45 else 0.2
    for _ in range(int(rng.integers(1, MAX_DISCS + 1))):
        toward = direction_of(math.radians(rng.uniform(-15, 85)), rng.uniform(0, 6.3))
        colour = _colour(rng, spread)
        if spread > 0.5 and rng.random() < 0.3:  # any hue, not only warm and cool
            colour = colour * np.exp(rng.normal(0, 0.7, 3))
        canvas.disc(toward, math.radians(log_uniform(rng, 1, 14)), colour * rng.uniform(0.4, 4))


def surroundings(canvas: _Canvas) -> None:
    """Contrasty noise: woods, streets, crowds, crooked rooms."""
    rng, d = canvas.rng, _directions()
    stretch = _tensor(np.array([1, 1, rng.uniform(0.6, 2)]) * rng.uniform(0.6, 2.5))
    field = fractal((d * stretch).reshape(-1, 3) + float(rng.uniform(0, 30)), 5, rng.uniform(0.5, 0.8)).reshape(HEIGHT, WIDTH, 4)
    level = rng.uniform(0.5, 1.7) * field[..., :1] + rng.uniform(0, 0.35) * field[..., 1:] + rng.uniform(0, 1.2) * d[..., 2:]
    canvas.map = torch.exp(level) * _tensor(_colour(rng, 0.12))


LIGHTS: tuple[tuple[Callable[[_Canvas], None], float], ...] = (
    (sky, 0.38), (overcast, 0.1), (studio, 0.2), (room, 0.14), (lamps, 0.1), (surroundings, 0.08),
)  # fmt: skip


def draw_light(rng: Generator) -> Light:
    """A light of a random family, or two mixed, each under a cast of its own: mild, clear or strong."""
    chosen = pick(rng, LIGHTS, 1 + (rng.random() < 0.4))
    total, discs = torch.zeros(HEIGHT, WIDTH, 3), []
    for paint in chosen:
        canvas = _Canvas(rng)
        paint(canvas)
        share = rng.uniform(0.3, 1) / float(_mean_irradiance(canvas)) * _colour(rng, rng.choice(CASTS, p=CAST_SHARES))
        key = _colour(rng, 0.3)  # lamps and sun are of another colour than what fills their shadows
        total = total + _tensor(share / key) * canvas.map
        discs += [(direction, cosine, share * key * emission) for direction, cosine, emission in canvas.discs]
    discs = discs[:MAX_DISCS]
    direction, cosine, emission = np.zeros((MAX_DISCS, 3)), np.full(MAX_DISCS, 2.0), np.zeros((MAX_DISCS, 3))
    for k, (toward, edge, radiance) in enumerate(discs):
        direction[k], cosine[k], emission[k] = toward, edge, radiance
    direction[len(discs) :] = (0, 0, 1)
    return Light(total.clamp_min(1e-4), _tensor(direction), _tensor(cosine), _tensor(emission))


def _mean_irradiance(canvas: _Canvas) -> Tensor:
    """Mean over directions and channels of what a surface receives, discs included."""
    area = row_solid_angles(HEIGHT, WIDTH).float()[:, None, None]
    total = (canvas.map * area).sum() / 3
    for _, cosine, emission in canvas.discs:
        total = total + float(emission.mean()) * 2 * math.pi * (1 - cosine)
    return total / 4
