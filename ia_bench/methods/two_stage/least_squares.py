"""The albedo that the photographs ask for once all else is recovered: a robust linear least-squares problem.

Radiance is albedo * E + the rest, where E, the diffuse radiance over the albedo, and the rest, what is mirrored, are those of the
finished fit. Its steps see each texel a few times, with a few samples; here all pixels, or PIXELS of them, count at once.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, splat
from ia_bench.methods.contract import Problem

STAY = 0.3
"""Weight of the squared change of a texel, where a pixel that is all diffuse and fits has 1."""
RESIDUAL = 0.2
"""Share of its radiance by which a pixel is off where its weight is halved: wrong highlights say nothing of the albedo."""
DIM = 0.05
"""Share of the mean radiance that is added to that of each pixel, so that black ones have a weight."""
LARGEST = 1.0
"""Change of the albedo that a pixel asks for at most."""
ITERATIONS = 5
PIXELS = 2**18
"""At most, drawn among all: large photographs show each texel in many."""
SAMPLES = 0.5
"""Samples a pixel, as a share of a step's: with these and ITERATIONS five sixths of the gain cost two thirds of the seconds."""


def solved_albedo(
    problem: Problem, exposures: Tensor | None, material: Material, light: SampledLight, generator: torch.Generator
) -> Tensor:
    """The albedo (T, T, 3) that is least in sum of w (pixel's mean albedo - (photograph - rest) / E)^2 + STAY |change|^2.

    It may lie out of [0, 1]. The weight w is the squared share of diffuse radiance in all of it, over
    1 + (residual / (RESIDUAL * radiance))^2, of each channel; pixels that the object covers in part, that a mask leaves out or
    that are not known have none.

    ``material`` and ``light`` are as recovered; where no pixel sees it, the albedo stays. ``exposures``: what renders of each view
    are multiplied with (V, 1 or 3), None where that is 1.
    """
    photographs = problem.photographs
    chosen = torch.nonzero(problem.gbuffer.filled & photographs.known[:, 0])[:, 0]
    chosen = chosen[torch.randperm(len(chosen), generator=generator, device=chosen.device)[:PIXELS].sort().values]
    if not len(chosen):
        return material.albedo
    gbuffer, surface = problem.gbuffer.at(chosen), problem.renderer.surface
    samples = max(1, int(SAMPLES * problem.plan.samples))
    rendered = problem.renderer.render_entries(gbuffer, material, light, samples, generator)
    factor = 1.0 if exposures is None else exposures[gbuffer.view()]
    diffuse, radiance = factor * rendered["diffuse"].clamp_min(0), factor * rendered["radiance"]
    residual = photographs.radiance[chosen] - radiance
    scale = radiance.clamp_min(0) + DIM * radiance.mean().clamp_min(1e-12)  # estimates may be below black
    weight = (diffuse / scale).square() / (1 + (residual / (RESIDUAL * scale)).square())
    light_there = diffuse / rendered["albedo"].clamp_min(1e-3)
    wanted = (residual / light_there.clamp_min(max(1e-4 * float(light_there.mean()), 1e-12))).clamp(-LARGEST, LARGEST)

    size, points = len(material.albedo), gbuffer.subsamples
    uv = surface.uv(gbuffer.face.long(), gbuffer.barycentric).reshape(-1, 2)

    def shown(texture: Tensor) -> Tensor:
        return surface.averaged(gbuffer.face, gbuffer.barycentric, texture)

    def spread(values: Tensor) -> Tensor:
        """The transpose of ``shown``."""
        mean, total = splat(uv, (values / points).repeat_interleave(points, 0), size)
        return mean * total[..., None]

    def normal(texture: Tensor) -> Tensor:
        return spread(weight * shown(texture)) + STAY * texture

    change = conjugate_gradients(normal, spread(weight * wanted), ITERATIONS)
    return material.albedo + change


def conjugate_gradients(matrix: Callable[[Tensor], Tensor], right: Tensor, iterations: int) -> Tensor:
    """About the solution of ``matrix`` (x) = ``right``, (T, T, C), a symmetric positive definite system for each channel."""

    def inner(one: Tensor, other: Tensor) -> Tensor:
        return (one * other).sum((0, 1))

    found, residual, step = torch.zeros_like(right), right, right
    square = inner(right, right)
    for _ in range(iterations):
        image = matrix(step)
        length = square / inner(step, image).clamp_min(1e-30)
        found, residual = found + length * step, residual - length * image
        former, square = square, inner(residual, residual)
        step = residual + square / former.clamp_min(1e-30) * step
    return found
