"""The light around an object, whatever represents it: a lat-long map, spherical Gaussians, a network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.latlong import direction_to_texel, texel_centres
from ia_bench.scenes.turning import TurningLight


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
    """A lat-long map whose ``texels`` (H, W, 3) each have one radiance all over; ``name``: what its scene calls it.

    ``turning``: how it turns with the camera that it is rendered for; the map is as it stands for the first photograph.
    """

    texels: Tensor
    name: str = ""
    turning: TurningLight | None = None

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


def turned(radiance: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A lat-long map (H, W, 3), turned by a ``rotation`` (3, 3), which may mirror: new(d) = old(rotation^T d). It keeps its size.

    Whole columns about the vertical axis are exact. All else is bilinear between the centres of texels, which keeps no sun's power.
    """
    height, width = radiance.shape[:2]
    columns = math.atan2(rotation[1, 0], rotation[0, 0]) * width / (2 * math.pi)
    upright = abs(rotation[2, 2] - 1) < 1e-9 and np.linalg.det(rotation) > 0
    if upright and abs(columns - round(columns)) < 1e-6:
        return np.roll(radiance, -round(columns), axis=1)  # the azimuth falls from left to right
    from scipy.ndimage import map_coordinates

    x, y, z = np.moveaxis(texel_centres(height, width).double().numpy() @ rotation, -1, 0)
    rows = (np.arccos(z.clip(-1, 1)) * (height / math.pi) - 0.5).clip(0, height - 1)
    places = [rows, ((math.pi - np.arctan2(y, x)) * (width / (2 * math.pi)) - 0.5) % width + 1]
    padded = np.concatenate([radiance[:, -1:], radiance, radiance[:, :1]], 1)  # around the sphere
    return np.stack([map_coordinates(padded[..., c], places, order=1, mode="nearest") for c in range(3)], -1).astype(np.float32)
