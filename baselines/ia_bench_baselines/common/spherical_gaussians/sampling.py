"""Directions drawn in proportion to a light of spherical Gaussians, so that a narrow lobe is not missed by a few of them."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.material.brdf import tangent_frame
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, fibonacci_axes


def draw_directions(lobes: SphericalGaussians, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """``count`` directions (D, 3), their density as the light's mean over channels, and 1 / (D density) of each (D,).

    The lobes are M, the same for all points, none of them negative. They are visited in proportion to their energies, in even
    steps from one random offset, so that each gets its share of the directions up to one. Black light is visited evenly.
    """
    device = lobes.axis.device
    energy = lobes.energy().mean(1)
    total = energy.sum()
    if float(total) == 0:
        return fibonacci_axes(count).to(device), torch.full((count,), 4 * math.pi / count, device=device)
    offset = torch.rand(1, generator=generator, device=device)
    steps = (torch.arange(count, device=device) + offset) / count
    chosen = torch.searchsorted((energy / total).cumsum(0), steps).clamp_max(len(energy) - 1)
    directions = directions_of_lobes(lobes.axis[chosen], lobes.sharpness[chosen], generator)
    return directions, total / (count * lobes.radiance(directions).mean(1))


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
