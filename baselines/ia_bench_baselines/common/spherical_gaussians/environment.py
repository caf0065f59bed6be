"""Light from infinitely far away as a sum of spherical Gaussians, and where a fit of it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import texel_centres
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians

FINEST_ROWS = 256  # of the map that is averaged down to smaller ones: narrow lobes must not fall between the texels' centres
DIRECTIONS_AT_ONCE = 2**14


@dataclass(frozen=True)
class SphericalGaussianEnvironment:
    """See :class:`ia_bench.light.environment.Environment`; ``lobes`` are M, the same for all points."""

    lobes: SphericalGaussians

    def radiance(self, directions: Tensor) -> Tensor:
        """See :class:`ia_bench.light.environment.Environment`."""
        return torch.cat([self.lobes.radiance(part) for part in directions.split(DIRECTIONS_AT_ONCE)])

    def latlong(self, height: int) -> Tensor:
        """See :class:`ia_bench.light.environment.Environment`: radiance at texels' centres, averaged from a finer map."""
        fine = height * max(1, -(-FINEST_ROWS // height))
        centres = texel_centres(fine, 2 * fine).to(self.lobes.axis)
        return LatLongEnvironment(self.radiance(centres.reshape(-1, 3)).reshape(*centres.shape[:2], -1)).latlong(height)


def fibonacci_axes(count: int) -> Tensor:
    """``count`` unit directions spread evenly over the sphere along a golden spiral, (count, 3)."""
    place = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * place + 1) / count
    azimuth = place * (math.pi * (3 - math.sqrt(5)))
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * torch.cos(azimuth), radius * torch.sin(azimuth), z], -1).float()
