"""The light around an object, whatever represents it: a lat-long map, spherical Gaussians, a network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from ia_bench.light.latlong import direction_to_texel


@runtime_checkable
class Environment(Protocol):
    """Light that comes from infinitely far away. Directions point away from the object; z is up."""

    def radiance(self, directions: Tensor) -> Tensor:
        """Radiance (N, 3) that arrives from unit ``directions`` (N, 3)."""
        ...

    def latlong(self, height: int) -> Tensor:
        """The same as a map (height, 2 height, 3), laid out as :mod:`ia_bench.light.latlong` says."""
        ...


@dataclass(frozen=True)
class LatLongEnvironment:
    """A lat-long map whose ``texels`` (H, W, 3) each have one radiance all over."""

    texels: Tensor

    def radiance(self, directions: Tensor) -> Tensor:
        """See :class:`Environment`: the texel that a direction falls into, without interpolation."""
        height, width, channels = self.texels.shape
        return self.texels.reshape(-1, channels)[direction_to_texel(directions, height, width)]

    def latlong(self, height: int) -> Tensor:
        """See :class:`Environment`: each new texel is the mean, over its solid angle, of what it covers, so power is kept."""
        rows, columns, _ = self.texels.shape
        if (height, 2 * height) == (rows, columns):
            return self.texels
        down = _shares(torch.cos(_edges(height) * math.pi), torch.cos(_edges(rows) * math.pi))
        across = _shares(_edges(2 * height), _edges(columns))
        mean = torch.einsum("hr,rcx,wc->hwx", down.to(self.texels.device), self.texels.double(), across.to(self.texels.device))
        return mean.to(self.texels.dtype)


def _edges(count: int) -> Tensor:
    return torch.arange(count + 1, dtype=torch.float64) / count


def _shares(new: Tensor, old: Tensor) -> Tensor:
    """The share (N, O) of each interval between the edges ``new`` (N + 1,) that lies in each one between ``old`` (O + 1,)."""
    new, old = (torch.stack([edges[:-1], edges[1:]], -1).sort(-1).values for edges in (new, old))
    low = torch.maximum(new[:, None, 0], old[:, 0])
    high = torch.minimum(new[:, None, 1], old[:, 1])
    return (high - low).clamp_min(0) / (new[:, 1] - new[:, 0])[:, None]
