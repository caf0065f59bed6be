"""Where the time of one optimisation step goes, and how far each phase is from what the machine allows."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import torch
from stage import Stage
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer, SurfacePoints
from ia_bench.render.renderer import Renderer
from ia_bench.render.visibility import TracedShadows

PHASES = ("sampling", "rays", "shading", "backward", "update")
WARM_UP = 3
COPY_FLOATS = 2**26  # 256 MB: no cache holds it


@dataclass(frozen=True)
class Phase:
    """Median CPU ``seconds`` of a phase, the ``megabytes`` it has to move, and the time that its ``limit`` would take."""

    name: str
    seconds: float
    megabytes: float
    limit: str
    limit_seconds: float | None


class Stopwatch:
    """CPU seconds between laps, by the name of what has just ended."""

    def __init__(self) -> None:
        self.laps: dict[str, list[float]] = defaultdict(list)
        self._last = 0.0

    def start(self) -> None:
        """Forget the time since the last lap."""
        self._last = time.process_time()

    def lap(self, name: str) -> None:
        """Book the time since the last lap."""
        now = time.process_time()
        self.laps[name].append(now - self._last)
        self._last = now


class TimedShadows:
    """Traced shadows between two laps, and the rays of the last step."""

    def __init__(self, shadows: TracedShadows, surface_offset: float, watch: Stopwatch) -> None:
        self._shadows, self._offset, self._watch = shadows, surface_offset, watch
        self._last: tuple[SurfacePoints, Tensor, Tensor] | None = None

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """See :class:`ia_bench.render.visibility.Visibility`."""
        self._watch.lap("sampling")
        blocked = self._shadows.blocked(points, direction, asked)
        self._watch.lap("rays")
        self._last = points, direction, asked
        return blocked

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (M, 3) of the last step's shadow rays."""
        assert self._last is not None
        points, direction, asked = self._last
        origin = (points.position + self._offset * points.geometric)[:, None].expand_as(direction)
        return origin[asked].numpy(), direction[asked].numpy()


def measure_phases(stage: Stage, gbuffer: GBuffer, pixels: int, samples: int, rounds: int, mitsuba: bool) -> list[Phase]:
    """Time ``rounds`` steps over ``pixels`` random pixels by phase, and the machine's limits in the same process.

    The bytes are those a phase cannot avoid if it keeps nothing: its inputs read and its outputs written once, as float32
    (texels as int32). The limit of rays is Embree's packet rate on the same mesh and the same rays, through Mitsuba.
    """
    watch = Stopwatch()
    shadows = TimedShadows(TracedShadows(stage.geometry.rays, stage.geometry.surface.offset), stage.geometry.surface.offset, watch)
    renderer = Renderer(stage.geometry.surface, shadows)
    log_light = torch.log(stage.light.clamp_min(1e-6)).requires_grad_()
    albedo, roughness = stage.material.albedo.clone().requires_grad_(), stage.material.roughness.clone().requires_grad_()
    optimizer = torch.optim.Adam([albedo, roughness, log_light], lr=1e-3, betas=(0.9, 0.99), fused=True)
    generator = torch.Generator().manual_seed(0)
    for number in range(WARM_UP + rounds):
        chosen = torch.randint(len(gbuffer.pixel), (pixels,), generator=generator)
        optimizer.zero_grad(set_to_none=True)
        if number == WARM_UP:
            watch.laps.clear()
        watch.start()
        light = SampledLight.of(torch.exp(log_light), uniform_fraction=0.2)
        rendered = renderer.render_pixels(gbuffer, chosen, Material(albedo, roughness), light, samples, generator)
        loss = (rendered.radiance - 0.3).abs().mean()
        watch.lap("shading")
        loss.backward()
        watch.lap("backward")
        optimizer.step()
        watch.lap("update")
    traced = len(shadows.rays()[0])
    moved = _bytes(pixels, samples, gbuffer.subsamples, traced, (albedo, roughness, log_light))
    bandwidth, rate = copy_bandwidth(), packet_rate(stage, shadows.rays()) if mitsuba else None
    phases = []
    for name in PHASES:
        limit, limit_seconds = f"memory, {bandwidth / 1e9:.1f} GB/s", moved[name] / bandwidth
        if name == "rays":
            limit = f"Embree's packets, {rate / 1e6:.1f} M rays/s" if rate else "Embree's packets: needs Mitsuba"
            limit_seconds = traced / rate if rate else None
        phases.append(Phase(name, float(np.median(watch.laps[name])), moved[name] / 1e6, limit, limit_seconds))
    return phases


def _bytes(
    pixels: int, samples: int, points_a_pixel: int, traced: int, parameters: tuple[Tensor, Tensor, Tensor]
) -> dict[str, int]:
    points, drawn = pixels * points_a_pixel, pixels * samples
    surface = 4 * (3 + 3 + 3 + 2 + 3)  # position, normal, view, UV, geometric normal of a point
    taps = 4 * 4 * (3 + 1)  # of two bilinear lookups
    sample = 4 + 16 + 2  # texel, terms, and the weight of those by the BRDF alone
    values = sum(parameter.numel() for parameter in parameters)
    light = parameters[2].numel()
    shading = points * (32 + taps) + drawn * (sample + 12)  # 12: the light's radiance, gathered
    return {
        "sampling": points * (surface + 16) + drawn * (sample + 12) + light * 4 * 4,  # 12: directions; the light's exp and tables
        "rays": traced * (24 + 1),
        "shading": shading + points * 36,
        "backward": shading + points * (36 + 2 * taps) + drawn * 24 + values * 4,  # 24: the light's gradient, read and written
        "update": values * 28,  # Adam reads value, gradient and two moments, and writes all but the gradient
    }


def copy_bandwidth() -> float:
    """Bytes a second, read and written, of copying an array that no cache holds; the best of five."""
    source, target = torch.ones(COPY_FLOATS), torch.empty(COPY_FLOATS)
    seconds = []
    for _ in range(6):
        started = time.process_time()
        target.copy_(source)
        seconds.append(time.process_time() - started)
    return 2 * 4 * COPY_FLOATS / min(seconds[1:])


def packet_rate(stage: Stage, rays: tuple[np.ndarray, np.ndarray]) -> float:
    """Shadow rays a CPU second that Embree's packets trace: Mitsuba's ``ray_test`` of the same rays, the best of five."""
    scene = stage.mitsuba([], torch.get_num_threads())
    mi, dr = scene.mi, scene.dr
    origin, direction = (mi.Point3f(rays[0].T.copy()), mi.Vector3f(rays[1].T.copy()))
    dr.eval(origin, direction)
    seconds = []
    for _ in range(6):  # the first compiles
        started = time.process_time()
        dr.eval(scene.scene.ray_test(mi.Ray3f(origin, direction)))
        dr.sync_thread()
        seconds.append(time.process_time() - started)
    return len(rays[0]) / min(seconds[1:])
