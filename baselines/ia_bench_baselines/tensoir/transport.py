"""Light that arrives at surface points: the environment's where nothing is in the way, the radiance head's where something is."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians
from ia_bench_baselines.tensoir.model import Tensoir


def arriving_light(
    stage: Stage, points: SurfacePoints, directions: Tensor, lobes: SphericalGaussians, reflections: Tensoir | None
) -> Tensor:
    """Radiance (N, D, 3) from directions (D, 3), through which gradients flow to the ``lobes`` alone.

    ``reflections``: the model whose radiance head tells what other parts of the object send; None for nothing, as under a light
    that the head was not trained with. What is below a point's horizon is 0.
    """
    every = directions.expand(len(points.position), -1, -1).contiguous()
    above = points.normal @ directions.T > 0
    face, barycentric, _ = stage.rays.intersect(points.position + stage.surface.offset * points.geometric, every, above)
    free = above & (face < 0)
    light = free[..., None] * lobes.radiance(directions)
    if reflections is None:
        return light
    point, direction = torch.nonzero(face >= 0, as_tuple=True)
    with torch.no_grad():
        normal, position = stage.surface.geometry(face[point, direction], barycentric[point, direction])
        away = -directions[direction]
        sent = reflections.radiance(reflections.features(reflections.local(position)), away)
        sent = sent * ((normal * away).sum(1, keepdim=True) > 0)  # the back of a triangle sends nothing
    return light.index_put((point, direction), sent)
