"""The lat-long environment light: where its texels lie, and exact sampling of a piecewise constant map.

Row 0 touches +z. Texel (r, c) spans theta in [pi r/H, pi (r+1)/H] from +z and phi in (pi - 2 pi (c+1)/W, pi - 2 pi c/W]
measured from +x toward +y. Radiance is constant inside a texel; inside it, directions are uniform in solid angle.
"""

from __future__ import annotations

import functools
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


BIN_SIDE = 8  # surface normals fall into an octahedral grid of 8 x 8 cells, each with its own sampling table
BIN_RADIUS = math.radians(29.4)  # the farthest normal of a cell is this far from its centre


def normal_bin(normal: Tensor) -> Tensor:
    """Octahedral cell (...,) int64 in [0, BIN_SIDE^2) of unit normals (..., 3)."""
    x, y, z = (normal / normal.abs().sum(-1, keepdim=True)).unbind(-1)
    folded_x = torch.where(z >= 0, x, (1 - y.abs()) * torch.where(x >= 0, 1.0, -1.0))
    folded_y = torch.where(z >= 0, y, (1 - x.abs()) * torch.where(y >= 0, 1.0, -1.0))
    column, row = (((0.5 + 0.5 * c) * BIN_SIDE).long().clamp(0, BIN_SIDE - 1) for c in (folded_x, folded_y))
    return row * BIN_SIDE + column


@functools.cache
def bin_centres() -> Tensor:
    """Unit normal at the centre of every octahedral cell, (BIN_SIDE^2, 3) float64."""
    line = (torch.arange(BIN_SIDE, dtype=torch.float64) + 0.5) / BIN_SIDE * 2 - 1
    y, x = torch.meshgrid(line, line, indexing="ij")
    z = 1 - x.abs() - y.abs()
    folded_x = torch.where(z >= 0, x, (1 - y.abs()) * torch.sign(x))
    folded_y = torch.where(z >= 0, y, (1 - x.abs()) * torch.sign(y))
    centres = torch.stack([folded_x, folded_y, z], -1).reshape(-1, 3)
    return centres / centres.norm(dim=-1, keepdim=True)


@functools.cache
def _bin_weights(height: int, width: int) -> tuple[Tensor, Tensor]:
    """Cosine bound of each cell toward each texel and its integral over the sphere: (B, H W), (B, 1), float32.

    Normals lie up to BIN_RADIUS off their cell's centre and directions half a texel off theirs, so a lit direction may be
    that much farther than 90 degrees from the centre; texels too large for that get the same bound everywhere.
    """
    cosine = bin_centres() @ texel_centres(height, width).double().reshape(-1, 3).T
    reach = BIN_RADIUS + 0.5 * math.hypot(math.pi / height, 2 * math.pi / width)
    bound = (cosine + math.sin(reach)).clamp_min(0) if reach < math.pi / 2 else torch.ones_like(cosine)
    total = (bound * row_solid_angles(height, width).repeat_interleave(width)).sum(1, keepdim=True)
    return bound.float(), total.float()


@dataclass(frozen=True)
class LatLongSampler:
    """Exact sampling of radiance times a bound of the cosine, one table per octahedral cell of surface normals.

    ``cumulative`` (B H W,) float64 (float32 would misplace dark texels beside a sun): cell b's cumulative texel
    probabilities plus b, so that one sorted search serves all cells; ``density`` (B H W,) per steradian.
    """

    cumulative: Tensor
    density: Tensor
    height: int
    width: int

    @classmethod
    def build(cls, radiance: Tensor, *, uniform_fraction: float = 0.0) -> LatLongSampler:
        """Tables proportional to the mean over channels of ``radiance`` (H, W, 3), solid angle, and the cosine bound.

        ``uniform_fraction`` of the samples ignores the radiance, so that dark texels that must still learn are visited.
        A cell that sees no light at all is sampled that way altogether.
        """
        height, width, _ = radiance.shape
        bound, total_bound = (table.to(radiance.device) for table in _bin_weights(height, width))
        solid_angle = row_solid_angles(height, width).to(radiance.device).float().repeat_interleave(width)
        brightness = radiance.detach().mean(-1).clamp_min(0).reshape(-1)
        power = ((bound * brightness) @ solid_angle)[:, None]
        lit = power > 0
        share = torch.where(lit, 1 - uniform_fraction, torch.zeros_like(power)) / torch.where(lit, power, 1.0)
        evenly = torch.where(lit, uniform_fraction, torch.ones_like(power)) / total_bound
        density = bound * (brightness * share + evenly)
        cumulative = (density * solid_angle).double().cumsum(1)
        cumulative = cumulative / cumulative[:, -1:]
        offset = torch.arange(len(bound), dtype=torch.float64, device=radiance.device)[:, None]
        return cls((cumulative + offset).reshape(-1), density.reshape(-1), height, width)


def sample_texels(cumulative: Tensor, cell: Tensor, u: Tensor, texels: int) -> Tensor:
    """Texel indices for uniform ``u`` (..., K) in [0, 1) and normal cells (..., 1), by inverting the cumulative tables."""
    found = torch.searchsorted(cumulative, (cell + u).contiguous(), right=True) - cell * texels
    return found.clamp(0, texels - 1)


def texel_to_direction(texel: Tensor, u: Tensor, v: Tensor, height: int, width: int) -> Tensor:
    """Directions uniform in solid angle inside the given texels; ``u``, ``v`` uniform in [0, 1): (..., 3)."""
    row, column = texel // width, texel % width
    upper, lower = torch.cos(row * (math.pi / height)), torch.cos((row + 1) * (math.pi / height))
    z = upper + (lower - upper) * u
    radius = torch.sqrt((1 - z * z).clamp_min(0))
    phi = math.pi - (column + v) * (2 * math.pi / width)
    return torch.stack([radius * torch.cos(phi), radius * torch.sin(phi), z], -1)
