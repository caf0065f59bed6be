"""Directions of light at surface points, drawn so that neither a narrow lobe of the light nor a glossy one is missed by few."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ia_bench.material.brdf import dot, sample_visible_ggx, tangent_frame, visible_ggx_pdf
from ia_bench.methods.photographs import cosine_directions
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians

DARK = 1e-20  # energy below which a light is drawn as if it had this much
RAREST = 1e-20  # least density that is divided by


class Directions(NamedTuple):
    """D directions of each of N points.

    Attributes:
        direction: (N, D, 3), unit.
        weight: (N, D), the solid angle that each stands for: sums over D of weight times values have the integral as their mean.
            0 below the horizon of the shading normal.
        radiance: (N, D, 3) that the light sends along them where nothing is in the way; differentiable in the light.
    """

    direction: Tensor
    weight: Tensor
    radiance: Tensor


def draw_directions(
    lobes: SphericalGaussians, points: SurfacePoints, roughness: Tensor, count: int, generator: torch.Generator
) -> Directions:
    """``count`` directions of each point, by three techniques of equal shares (balance heuristic, Veach and Guibas 1995).

    In proportion to the light, whose M lobes are the same for all points and are visited in even steps in proportion to their
    energies; to GGX of ``roughness`` (N, 1) by its visible normals; and to the cosine. No gradient passes through what is drawn.
    """
    numbers = [(count + 2 - technique) // 3 for technique in range(3)]
    with torch.no_grad():
        direction = _drawn(lobes, points, roughness, numbers, generator)
        point, which = torch.nonzero((direction @ points.normal[..., None])[..., 0] > 0, as_tuple=True)
        above = direction[point, which]
    radiance = lobes.radiance(above)
    with torch.no_grad():
        by_light = radiance.mean(1, keepdim=True) / lobes.energy().mean(1).sum().clamp_min(DARK)
        by_gloss = visible_ggx_pdf(points.normal[point], points.view[point], above, roughness[point])
        by_cosine = dot(points.normal[point], above) / math.pi
        density = torch.cat([by_light, by_gloss, by_cosine], 1) @ direction.new_tensor(numbers)
        weight = direction.new_zeros(direction.shape[:2]).index_put((point, which), 1 / density.clamp_min(RAREST))
    return Directions(direction, weight, torch.zeros_like(direction).index_put((point, which), radiance))


def _drawn(
    lobes: SphericalGaussians, points: SurfacePoints, roughness: Tensor, numbers: list[int], generator: torch.Generator
) -> Tensor:
    """Directions (N, D, 3) of the three techniques, so many each."""
    normal, view, device = points.normal, points.view, points.normal.device

    def even(number: int, shape: tuple[int, ...]) -> Tensor:
        """``number`` even steps from a random offset, in [0, 1)."""
        return (torch.arange(number, device=device) + torch.rand(*shape, 1, generator=generator, device=device)) / number

    def pairs(number: int) -> Tensor:
        """(N, number, 2), the first even, the second independent of it."""
        return torch.stack([even(number, (len(normal),)), torch.rand(len(normal), number, generator=generator, device=device)], -1)

    energy = lobes.energy().mean(1)
    shares = (energy / energy.sum().clamp_min(DARK)).cumsum(0)
    chosen = torch.searchsorted(shares, even(numbers[0], (len(normal),))).clamp_max(len(energy) - 1)
    by_light = directions_of_lobes(lobes.axis[chosen], lobes.sharpness[chosen], generator)
    by_gloss = sample_visible_ggx(normal[:, None], view[:, None], roughness[:, None], pairs(numbers[1]))
    by_cosine = cosine_directions(normal, pairs(numbers[2]).flip(-1))
    return torch.cat([by_light, by_gloss, by_cosine], 1)


def directions_of_lobes(axis: Tensor, sharpness: Tensor, generator: torch.Generator) -> Tensor:
    """A direction (..., 3) from each lobe of ``axis`` (..., 3) and ``sharpness`` lambda (...), in proportion to its values.

    cos = 1 + log(u + (1 - u) exp(-2 lambda)) / lambda, as of the von Mises-Fisher distribution.
    """
    u, turn = torch.rand(2, *sharpness.shape, generator=generator, device=axis.device)
    cosine = (1 + torch.log(u + (1 - u) * torch.exp(-2 * sharpness)) / sharpness).clamp_min(-1)  # of log 0
    radius, azimuth = torch.sqrt((1 - cosine * cosine).clamp_min(0)), 2 * math.pi * turn
    tangent, bitangent = tangent_frame(axis)
    around = torch.cos(azimuth)[..., None] * tangent + torch.sin(azimuth)[..., None] * bitangent
    return radius[..., None] * around + cosine[..., None] * axis
