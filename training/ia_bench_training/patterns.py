"""Procedural patterns: functions of the place in a part with values in [0, 1], from which materials are made.

All draws are made when a pattern is drawn, so that it is a pure function after.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench_training.draws import log_uniform, pick, rotation
from ia_bench_training.noise import FIRST, cells, fractal, hashed

Pattern = Callable[[Tensor, Tensor], Tensor]
"""Local points (N, 3) and the dominant axis of the surface there (N,) to values (N,) in [0, 1]."""


def _frame(rng: Generator) -> tuple[Tensor, Tensor]:
    """A rotation (upright in two thirds of the draws) and a shift of the pattern."""
    turn = np.eye(3) if rng.random() < 0.67 else rotation(rng)
    return torch.from_numpy(turn).float(), torch.from_numpy(rng.uniform(0, 30, 3)).float()


def _unit(x: Tensor) -> Tensor:
    """Map noise of mean 0 and a standard deviation near 1 (:func:`fractal` has 1.25) to [0, 1]."""
    return torch.sigmoid(1.5 * x)


def _soft_step(x: Tensor, width: float) -> Tensor:
    return (x / max(width, 1e-4) + 0.5).clamp(0, 1)


def clouds(rng: Generator) -> Pattern:
    """Fractal noise, possibly drawn out along an axis: stains, fur, brushed metal, photographs."""
    turn, shift = _frame(rng)
    scale, octaves, gain = log_uniform(rng, 0.7, 5), int(rng.integers(1, 7)), rng.uniform(0.4, 0.75)
    stretch = torch.tensor([1.0, 1.0, log_uniform(rng, 0.1, 1) if rng.random() < 0.35 else 1.0]) * scale
    ridged = rng.random() < 0.2

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        value = fractal((p @ turn) * stretch + shift, octaves, gain, channels=FIRST)[:, 0]
        return 1 - value.abs().mul(0.7).clamp(max=1) if ridged else _unit(value)

    return pattern


def stripes(rng: Generator) -> Pattern:
    """Bands across an axis or around it, even or of random widths, sharp or soft, straight or wavy."""
    turn, shift = _frame(rng)
    count, wavy = log_uniform(rng, 1.5, 9), rng.uniform(0, 0.15) * (rng.random() < 0.5)
    kind, soft, duty = rng.integers(0, 4), rng.choice([0.05, 0.05, 0.4]), rng.uniform(0.2, 0.8)

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        q = p @ turn
        if wavy:
            q = q + wavy * fractal(q * 2 + shift, 2, channels=slice(0, 3))
        x = torch.atan2(q[:, 1], q[:, 0]) * (round(count) / (2 * math.pi)) if kind == 0 else q[:, 2] * count + shift[0]
        if kind == 1:  # every band a value of its own
            cell = torch.floor(x).long()[:, None] * torch.tensor([1, 3, 7])
            return hashed(cell)[:, 0]
        return _soft_step(duty / 2 - (torch.remainder(x, 1) - 0.5).abs(), soft)

    return pattern


def checks(rng: Generator) -> Pattern:
    """A chessboard on the surface, or gingham."""
    turn, shift = _frame(rng)
    count, gingham = log_uniform(rng, 1.5, 7), rng.random() < 0.4

    def pattern(p: Tensor, axis: Tensor) -> Tensor:
        uv = on_surface(p @ turn, axis) * count + shift[:2]
        odd = torch.remainder(torch.floor(uv), 2)
        return odd.mean(-1) if gingham else torch.remainder(odd.sum(-1), 2)

    return pattern


def wood(rng: Generator) -> Pattern:
    """Rings around an axis, bent by noise, with fibres along it."""
    turn, shift = _frame(rng)
    rings, bend, fibre = log_uniform(rng, 3, 14), rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.4)
    off = torch.from_numpy(rng.normal(0, 0.5, 2)).float()

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        q = p @ turn
        warp = fractal(q * torch.tensor([1.2, 1.2, 0.4]) + shift, 2, channels=slice(0, 2))
        radius = (q[:, :2] - off + bend * warp).norm(dim=-1) * rings
        ring = torch.remainder(radius, 1)
        fine = fractal(q * torch.tensor([25.0, 25.0, 1.5]) + shift, 2, channels=slice(3, 4))[:, 0]
        return (ring**1.5 * (1 - fibre) + fibre * _unit(fine)).clamp(0, 1)

    return pattern


def marble(rng: Generator) -> Pattern:
    """Sharp veins in a cloudy ground."""
    turn, shift = _frame(rng)
    count, turbulence, sharp = log_uniform(rng, 1, 5), rng.uniform(0.5, 2), rng.uniform(0.15, 0.8)

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        q = p @ turn
        field = fractal(q * 1.5 + shift, 5, 0.6, channels=slice(0, 2))
        vein = torch.sin(count * q[:, 2] * 3 + turbulence * field[:, 0] * 1.5).abs() ** sharp
        return (0.85 * vein + 0.15 * _unit(field[:, 1])).clamp(0, 1)

    return pattern


def cellular(rng: Generator) -> Pattern:
    """Cells: mosaic of flat patches, cracks between them, pebbles, or spots."""
    turn, shift = _frame(rng)
    scale, kind, jitter = log_uniform(rng, 1.5, 7), rng.integers(0, 4), rng.uniform(0.5, 1)
    stretch = torch.tensor([1.0, 1.0, log_uniform(rng, 0.4, 1)]) * scale
    size = rng.uniform(0.2, 0.45)

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        first, second, value = cells((p @ turn) * stretch + shift, jitter)
        if kind == 0:
            return value[:, 0]
        if kind == 1:
            return _soft_step(second - first - 0.1, 0.08)
        if kind == 2:
            return (1 - first).clamp(0, 1)
        return _soft_step(size * (0.5 + value[:, 1]) - first, 0.06)

    return pattern


def weave(rng: Generator) -> Pattern:
    """Threads over and under each other: cloth, baskets, knitting."""
    turn, shift = _frame(rng)
    count, contrast = log_uniform(rng, 4, 14), rng.uniform(0.2, 0.6)

    def pattern(p: Tensor, axis: Tensor) -> Tensor:
        uv = on_surface(p @ turn, axis) * count + shift[:2]
        cell, inside = torch.floor(uv), torch.remainder(uv, 1) - 0.5
        over = torch.remainder(cell.sum(-1), 2)
        across = torch.where(over > 0, inside[:, 0], inside[:, 1])
        thread = 1 - 4 * across * across
        return (over * contrast + (1 - contrast) * thread).clamp(0, 1)

    return pattern


def dots(rng: Generator) -> Pattern:
    """Polka dots, rings or rounded squares on a grid, staggered or not."""
    turn, shift = _frame(rng)
    count, radius, stagger = log_uniform(rng, 1.5, 8), rng.uniform(0.15, 0.42), 0.5 * (rng.random() < 0.6)
    hollow, power = rng.random() < 0.25, float(rng.choice([2, 2, 6]))

    def pattern(p: Tensor, axis: Tensor) -> Tensor:
        uv = on_surface(p @ turn, axis) * count + shift[:2]
        row = torch.floor(uv[:, 1])
        u = torch.remainder(uv[:, 0] + stagger * torch.remainder(row, 2), 1) - 0.5
        v = torch.remainder(uv[:, 1], 1) - 0.5
        distance = (u.abs() ** power + v.abs() ** power) ** (1 / power)
        return _soft_step((0.08 - (distance - radius).abs()) if hollow else radius - distance, 0.06)

    return pattern


def bricks(rng: Generator) -> Pattern:
    """Bricks, tiles or planks with joints, every one a little different."""
    turn, shift = _frame(rng)
    count, long, joint = log_uniform(rng, 2, 7), rng.uniform(1, 4), rng.uniform(0.04, 0.12)
    offset = float(rng.choice([0, 0.5, 0.33]))

    def pattern(p: Tensor, axis: Tensor) -> Tensor:
        uv = on_surface(p @ turn, axis) * count + shift[:2]
        row = torch.floor(uv[:, 1])
        u = uv[:, 0] / long + offset * row
        column = torch.floor(u)
        near = torch.minimum(0.5 - (u - column - 0.5).abs(), (0.5 - (uv[:, 1] - row - 0.5).abs()) / long)
        brick = hashed(torch.stack([column, row, axis.float()], -1).long())[:, 0]
        return _soft_step(near - joint / long, 0.02) * (0.3 + 0.7 * brick)

    return pattern


def glyphs(rng: Generator) -> Pattern:
    """Prints: a grid of small random bitmaps, mirrored at times, that look like letters, signs or ornaments."""
    turn, shift = _frame(rng)
    count, pixels, mirror = log_uniform(rng, 0.8, 5), int(rng.integers(4, 7)), rng.random() < 0.6
    fill, sparse = rng.uniform(0.4, 0.65), rng.uniform(0.4, 1)

    def pattern(p: Tensor, axis: Tensor) -> Tensor:
        uv = on_surface(p @ turn, axis) * count + shift[:2]
        cell = torch.floor(uv)
        inside = (uv - cell - 0.5) * 1.3 + 0.5
        if mirror:
            inside = torch.stack([0.5 - (inside[:, 0] - 0.5).abs(), inside[:, 1]], -1)
        pixel = torch.floor(inside * pixels)
        bit = hashed(torch.cat([cell * 13 + pixel, pixel[:, :1] * 5 + pixel[:, 1:]], -1).long())[:, 0] < fill
        printed = hashed(torch.cat([cell, axis[:, None].float()], -1).long())[:, 2] < sparse
        outside = (inside < 0).any(-1) | (inside >= 1).any(-1)
        return (bit & printed & ~outside).float()

    return pattern


def gradient(rng: Generator) -> Pattern:
    """A smooth change along an axis or from the middle."""
    turn, _ = _frame(rng)
    middle, reach, round_ = rng.uniform(-0.4, 0.4), rng.uniform(0.3, 1), rng.random() < 0.25

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        q = p @ turn
        return (q.norm(dim=-1) if round_ else (q[:, 2] - middle) / reach * 0.5 + 0.5).clamp(0, 1)

    return pattern


def speckles(rng: Generator) -> Pattern:
    """Granite, terrazzo, sprinkles: thresholded fine noise."""
    _, shift = _frame(rng)
    scale, level = log_uniform(rng, 5, 16), rng.uniform(-0.6, 1.2)

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        return _soft_step(fractal(p * scale + shift, 2, channels=FIRST)[:, 0] - level, 0.3)

    return pattern


def patches(rng: Generator) -> Pattern:
    """Camouflage, maps, hides: contours of smooth noise in flat steps."""
    _, shift = _frame(rng)
    scale, steps, octaves = log_uniform(rng, 0.8, 3), int(rng.integers(2, 6)), int(rng.integers(1, 4))

    def pattern(p: Tensor, _: Tensor) -> Tensor:
        value = _unit(fractal(p * scale + shift, octaves, channels=FIRST)[:, 0])
        return (torch.floor(value * steps) / max(steps - 1, 1)).clamp(0, 1)

    return pattern


PATTERNS: tuple[tuple[Callable[[Generator], Pattern], float], ...] = (
    (clouds, 1.6), (stripes, 1.2), (checks, 0.6), (wood, 1.2), (marble, 0.9), (cellular, 0.8), (weave, 0.7), (dots, 0.8),
    (bricks, 0.8), (glyphs, 1.1), (gradient, 0.8), (speckles, 0.7), (patches, 0.8),
)  # fmt: skip


def on_surface(p: Tensor, axis: Tensor) -> Tensor:
    """The two coordinates (N, 2) of ``p`` that lie in the plane most parallel to the surface."""
    first = torch.tensor([1, 0, 0])[axis]
    second = torch.tensor([2, 2, 1])[axis]
    return torch.stack([p.gather(1, first[:, None])[:, 0], p.gather(1, second[:, None])[:, 0]], -1)


def draw_pattern(rng: Generator) -> Pattern:
    """A pattern of a random family."""
    return pick(rng, PATTERNS)[0](rng)
