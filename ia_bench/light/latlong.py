"""The lat-long environment light: where its texels lie, and exact sampling of a piecewise constant map.

Row 0 touches +z. Texel (r, c) spans theta in [pi r/H, pi (r+1)/H] from +z and phi in (pi - 2 pi (c+1)/W, pi - 2 pi c/W]
measured from +x toward +y. Radiance is constant inside a texel; inside it, directions are uniform in solid angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


def row_solid_angles(height: int, width: int) -> Tensor:
    """Solid angle of one texel of each row, (height,) float64 steradians; they sum to 4 pi over the map."""
    edges = torch.cos(torch.arange(height + 1, dtype=torch.float64) * (math.pi / height))
    return (edges[:-1] - edges[1:]) * (2 * math.pi / width)


def direction_to_texel(direction: Tensor, height: int, width: int) -> Tensor:
    """Flat texel index (...,) int64 of unit directions (..., 3)."""
    x, y, z = direction.unbind(-1)
    row = torch.acos(z.clamp(-1, 1)) * (height / math.pi)
    column = (math.pi - torch.atan2(y, x)) * (width / (2 * math.pi))
    return row.long().clamp(0, height - 1) * width + column.long().clamp(0, width - 1)


def texel_centres(height: int, width: int) -> Tensor:
    """Unit direction of every texel's centre, (height, width, 3)."""
    theta = (torch.arange(height) + 0.5) * (math.pi / height)
    phi = math.pi - (torch.arange(width) + 0.5) * (2 * math.pi / width)
    sin, cos = torch.sin(theta)[:, None], torch.cos(theta)[:, None].expand(height, width)
    return torch.stack([sin * torch.cos(phi), sin * torch.sin(phi), cos], -1)


def resize_light(radiance: np.ndarray, height: int) -> np.ndarray:
    """Average a (H, W, 3) map down to (height, 2 height, 3), weighted by solid angle, so that power is kept.

    Only whole-number reductions are exact; anything else raises ValueError.
    """
    rows, columns = radiance.shape[:2]
    if rows == height and columns == 2 * height:
        return radiance
    if rows % height or columns % (2 * height):
        raise ValueError(f"cannot average a {rows} x {columns} light to {height} x {2 * height}: not a whole factor")
    weight = row_solid_angles(rows, columns).numpy()[:, None, None]
    blocks = (height, rows // height, 2 * height, columns // (2 * height))
    power = (radiance * weight).reshape(*blocks, -1).sum((1, 3))
    area = np.broadcast_to(weight, (rows, columns, 1)).reshape(*blocks, 1).sum((1, 3))
    return (power / area).astype(np.float32)


@dataclass(frozen=True)
class LatLongSampler:
    """Sampling tables of one map: cumulative texel probabilities and the density of each texel per steradian."""

    cumulative: Tensor  # (H W,) float64 (float32 would misplace dark texels beside a sun), last entry 1
    density: Tensor  # (H W,) per steradian
    height: int
    width: int

    @classmethod
    def build(cls, radiance: Tensor, *, uniform_fraction: float = 0.0) -> LatLongSampler:
        """Tables proportional to the mean over channels of ``radiance`` (H, W, 3) times solid angle.

        ``uniform_fraction`` of the samples is spread evenly over the sphere, so that dark texels that must still learn
        are visited. A map without any power is sampled uniformly.
        """
        height, width, _ = radiance.shape
        solid_angle = row_solid_angles(height, width)[:, None].expand(height, width)
        power = radiance.detach().double().mean(-1).clamp_min(0) * solid_angle
        total = power.sum()
        even = solid_angle / (4 * math.pi)
        probability = even if total <= 0 else (1 - uniform_fraction) * power / total + uniform_fraction * even
        cumulative = probability.flatten().cumsum(0)
        cumulative = cumulative / cumulative[-1]
        density = (probability / solid_angle).flatten()
        return cls(cumulative, density.float(), height, width)


def sample_texels(cumulative: Tensor, u: Tensor) -> Tensor:
    """Texel indices for uniform ``u`` in [0, 1) by inverting the cumulative table."""
    return torch.searchsorted(cumulative, u, right=True).clamp(max=len(cumulative) - 1)


def texel_to_direction(texel: Tensor, u: Tensor, v: Tensor, height: int, width: int) -> Tensor:
    """Directions uniform in solid angle inside the given texels; ``u``, ``v`` uniform in [0, 1): (..., 3)."""
    row, column = texel // width, texel % width
    upper, lower = torch.cos(row * (math.pi / height)), torch.cos((row + 1) * (math.pi / height))
    z = upper + (lower - upper) * u
    radius = torch.sqrt((1 - z * z).clamp_min(0))
    phi = math.pi - (column + v) * (2 * math.pi / width)
    return torch.stack([radius * torch.cos(phi), radius * torch.sin(phi), z], -1)
