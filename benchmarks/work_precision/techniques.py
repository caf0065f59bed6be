"""Ways of drawing directions that the renderer has not: what its choice is measured against, never what it renders with.

A technique is a mixture of samplers, each with an equal share of the samples, joined by the balance heuristic; alone it is
plain importance sampling. Points in the unit cube come from three rules. Forward only; nothing here carries a gradient.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from benchmarks.reference import density as light_density
from benchmarks.reference import normal_bin, sample_texel
from ia_bench.light.latlong import LatLongSampler, direction_to_texel, texel_to_direction
from ia_bench.material.brdf import dot, sample_visible_ggx, tangent_frame, visible_ggx_pdf
from ia_bench.render.estimator import lattice

TECHNIQUES: dict[str, tuple[str, ...]] = {
    "uniform": ("hemisphere",),
    "cosine": ("cosine",),
    "light": ("light",),
    "BRDF": ("cosine", "ggx"),  # one sampler for each lobe
    "MIS": ("light", "ggx"),  # the renderer's
}


def unit_points(rule: str, pixels: int, points: int, count: int, generator: torch.Generator) -> Tensor:
    """``count`` samples for each of ``points`` points of a pixel: (pixels, points, count, 3) in [0, 1)^3, float64.

    "independent"; "stratified": the first coordinate has one sample in each of points x count equal strata of a pixel, the
    others are independent; "lattice": the renderer's rank-1 lattice under a Cranley-Patterson rotation.
    """
    device = generator.device
    if rule == "lattice":
        return lattice(torch.rand(pixels, 3, generator=generator, dtype=torch.float64, device=device), points, count)
    drawn = torch.rand(pixels, points, count, 3, generator=generator, dtype=torch.float64, device=device)
    if rule == "stratified":
        stratum = torch.arange(points)[:, None] + points * torch.arange(count)  # as the lattice deals its samples out
        drawn[..., 0] = (stratum.to(device) + drawn[..., 0]) / (points * count)
    return drawn.clamp(max=1 - 2**-24)


def technique_directions(
    technique: str, normal: Tensor, view: Tensor, roughness: Tensor, unit: tuple[Tensor, ...], sampler: LatLongSampler
) -> tuple[Tensor, Tensor, Tensor]:
    """Directions of a technique for N points, as :func:`benchmarks.reference.sample_directions` gives them.

    ``normal``, ``view`` (N, 3); ``roughness`` (N, 1); ``unit``: one (N, K, 3) set in [0, 1) for each of the technique's samplers.
    Returns direction (N, J K, 3), light texel (N, J K) and the balance heuristic's weight (N, J K, 1) of J samplers.
    """
    cell, n, o, r = normal_bin(normal)[:, None], normal[:, None], view[:, None], roughness[:, None]
    samplers = TECHNIQUES[technique]
    directions, texels = [], []
    for name, u in zip(samplers, unit, strict=True):
        if name == "light":
            texel = sample_texel(sampler, cell, u[..., 0])
            v = u.float()
            directions.append(texel_to_direction(texel, v[..., 1], v[..., 2], sampler.height, sampler.width))
        else:
            drawn = sample_visible_ggx(n, o, r, u[..., :2].float()) if name == "ggx" else _around(n, u.float(), name)
            directions.append(drawn)
            texel = direction_to_texel(drawn, sampler.height, sampler.width)
        texels.append(texel)
    direction, texel = torch.cat(directions, 1), torch.cat(texels, 1)
    cosine = dot(n, direction)
    density: dict[str, Callable[[], Tensor]] = {
        "hemisphere": lambda: torch.full_like(cosine, 1 / (2 * math.pi)),
        "cosine": lambda: cosine / math.pi,
        "light": lambda: light_density(sampler, cell, texel)[..., None],
        "ggx": lambda: visible_ggx_pdf(n, o, direction, r),
    }
    pdf = torch.stack([density[name]() for name in samplers]).sum(0)
    weight = 1 / (unit[0].shape[1] * pdf.clamp_min(1e-12))
    return direction, texel, torch.where(cosine > 0, weight, torch.zeros_like(weight))


def _around(normal: Tensor, u: Tensor, name: str) -> Tensor:
    """Directions (N, K, 3) of the hemisphere around (N, 1, 3) normals, uniform in solid angle or by the cosine."""
    cosine = u[..., 0:1] if name == "hemisphere" else torch.sqrt(u[..., 0:1])
    sine, azimuth = torch.sqrt(1 - cosine * cosine), 2 * math.pi * u[..., 1:2]
    tangent, bitangent = tangent_frame(normal)
    return sine * (torch.cos(azimuth) * tangent + torch.sin(azimuth) * bitangent) + cosine * normal
