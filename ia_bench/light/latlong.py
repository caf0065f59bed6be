"""The lat-long environment light: where its texels lie, and exact sampling of a piecewise constant map.

Row 0 touches +z. Texel (r, c) spans theta in [pi r/H, pi (r+1)/H] from +z and phi in (pi - 2 pi (c+1)/W, pi - 2 pi c/W]
measured from +x toward +y. Radiance is constant inside a texel; inside it, directions are uniform in solid angle.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ia_bench.scenes.turning import TurningLight


def row_solid_angles(height: int, width: int) -> Tensor:
    """Solid angle of one texel of each row, (height,) float64 steradians; they sum to 4 pi over the map."""
    edges = torch.cos(torch.arange(height + 1, dtype=torch.float64) * (math.pi / height))
    return (edges[:-1] - edges[1:]) * (2 * math.pi / width)


def direction_to_texel(direction: Tensor, height: int, width: int) -> Tensor:
    """The texel (...,) int64 that each unit direction (..., 3) falls into, as a flat index."""
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


BIN_SIDE = 8  # surface normals fall into an octahedral grid of 8 x 8 cells, each with its own sampling table
BIN_RADIUS = math.radians(29.4)  # of a cell around its centre; .1 less than its farthest normal has, where BRDF samples cover
AT_ONCE = 2**24  # pairs of a cell and a texel: a table of them is 128 MB
BLOCK_ROWS = 16  # the cosine is bounded on at most this many rows of blocks of texels, and twice as many columns


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


class SamplingGrid(NamedTuple):
    """What sampling needs to know of a map's size alone: B cells of normals, K blocks of neighbouring texels, T = H W texels.

    Attributes:
        bound: (B, K) float32, positive wherever the cosine between a normal of the cell and a direction of the block can be,
            and in maps of 4 rows or more not much below the largest.
        total: (B, 1), the integral of ``bound`` over the sphere.
        solid_angle: (T,) float64 steradians.
        order: (T,) int32, the texels sorted by their block.
        block: (T,) int32, the block of each texel.
        end: (K,) int32, where each block's texels end in ``order``.
        heights: (H + 1,) float32, z between the rows of texels.
    """

    bound: Tensor
    total: Tensor
    solid_angle: Tensor
    order: Tensor
    block: Tensor
    end: Tensor
    heights: Tensor


@functools.cache
def sampling_grid(height: int, width: int, device: torch.device) -> SamplingGrid:
    """The blocks of a ``height`` x ``width`` map, at most BLOCK_ROWS x 2 BLOCK_ROWS of them, and the cosine's bound on each.

    A normal lies up to BIN_RADIUS off its cell's centre and a direction up to half a texel off its texel's centre. So a
    direction that lights a normal may be farther than 90 degrees from the cell's centre by both together. Where texels are
    too large for such a bound, it is the same everywhere. A block takes the largest bound of its texels.
    """
    rows, columns = min(height, BLOCK_ROWS), min(width, 2 * BLOCK_ROWS)
    row, column = torch.arange(height) * rows // height, torch.arange(width) * columns // width
    block = (row[:, None] * columns + column).reshape(-1)
    centres, directions = bin_centres(), texel_centres(height, width).double().reshape(-1, 3)
    reach = BIN_RADIUS + 0.5 * math.hypot(math.pi / height, 2 * math.pi / width)
    solid_angle = row_solid_angles(height, width).repeat_interleave(width)
    bounds, totals = list[Tensor](), list[Tensor]()
    for some in centres.split(max(1, AT_ONCE // len(block))):  # all of them, but of large maps, which would take 2 kB a texel
        cosine = some @ directions.T
        texel_bound = (cosine + math.sin(reach)).clamp_min(0) if reach < math.pi / 2 else torch.ones_like(cosine)
        largest = torch.zeros(len(some), rows * columns, dtype=torch.float64)
        bounds.append(largest.scatter_reduce(1, block.expand_as(texel_bound), texel_bound, "amax").float())
        totals.append((bounds[-1][:, block] * solid_angle).sum(1, keepdim=True).float())
    bound, total = torch.cat(bounds), torch.cat(totals)
    end = torch.bincount(block).cumsum(0)
    order = torch.argsort(block, stable=True)
    heights = torch.cos(torch.arange(height + 1, dtype=torch.float64) * (math.pi / height)).float()
    grid = SamplingGrid(bound, total, solid_angle, order.int(), block.int(), end.int(), heights)
    return SamplingGrid(*(table.to(device) for table in grid))


class LatLongSampler(NamedTuple):
    """Exact sampling of radiance times a bound of the cosine, for normals that are sorted into octahedral cells.

    The density per steradian is ``bound(cell, block) * (share(cell) * brightness(texel) + evenly(cell))``. The bound is
    constant on a block of texels, so a draw takes two searches in small tables. The first finds one of the cell's 2 K
    entries: a block, and whether its texels are drawn by radiance or evenly. The second finds a texel of that block.

    Attributes:
        entries: (2 B K + 1,) float64. One cumulative distribution per cell, concatenated after a leading 0. That of cell b
            is shifted by b, so that a single ``searchsorted(entries, b + u)`` finds the entry within cell b.
        texels: (2 T,) float64. The running sum of brightness times solid angle over all texels, block by block, and then
            of the solid angle alone. In float32 dark texels beside a sun would be misplaced; in float64 one of 1e8 times
            their radiance moves their shares by at most 3e-3, one of 1e10 by a quarter. Densities are right beside any.
        edges: (2 K + 1,), where in ``texels`` each entry's block begins and ends.
        brightness: (T,) float32, the mean over channels of the radiance, divided by its integral over the sphere.
        share: (B,) float32, the factor of what is drawn by radiance.
        evenly: (B,) float32, what is drawn evenly, over the bound's integral.
        grid: What depends on the map's size alone.
        height: Rows of the map.
        width: Columns of the map.
    """

    entries: Tensor
    texels: Tensor
    edges: Tensor
    brightness: Tensor
    share: Tensor
    evenly: Tensor
    grid: SamplingGrid
    height: int
    width: int

    @classmethod
    def build(cls, radiance: Tensor, *, uniform_fraction: float = 0.0) -> LatLongSampler:
        """Make the tables for ``radiance`` (H, W, 3), whose channels are averaged.

        ``uniform_fraction`` of the samples ignores the radiance, so that dark texels that must still learn are visited.
        All samples of a cell that sees no light at all do.

        Raises:
            FloatingPointError: The radiance holds NaN or infinity.
        """
        height, width, _ = radiance.shape
        grid = sampling_grid(height, width, radiance.device)
        mean = radiance.detach().mean(-1).reshape(-1)
        brightness = mean.clamp_min(0)
        total = brightness.double() @ grid.solid_angle
        if bad := int((~torch.isfinite(mean)).sum()):
            raise FloatingPointError(f"light: expected finite radiance, found NaN or Inf in {bad} of {height * width} texels")
        brightness = (brightness / torch.where(total > 0, total, 1.0)).float()
        texels = torch.cat([(brightness * grid.solid_angle)[grid.order], grid.solid_angle[grid.order]]).cumsum(0)
        edges = torch.cat([texels.new_zeros(1), texels[grid.end - 1], texels[grid.end - 1 + len(brightness)]])
        mass = edges.diff().reshape(2, 1, -1)  # radiance times solid angle, and solid angle, of every block
        power = (grid.bound * mass[0]).sum(1, keepdim=True)
        lit = power > 0
        share = torch.where(lit, 1 - uniform_fraction, 0.0) / torch.where(lit, power, 1.0)
        evenly = torch.where(lit, uniform_fraction, 1.0) / grid.total
        probability = torch.cat([grid.bound * share * mass[0], grid.bound * evenly * mass[1]], 1)
        entries = probability.cumsum(1)
        entries = entries / entries[:, -1:] + torch.arange(len(entries), device=radiance.device)[:, None]
        entries = torch.cat([entries.new_zeros(1), entries.reshape(-1)])
        return cls(entries, texels, edges, brightness, share[:, 0].float(), evenly[:, 0].float(), grid, height, width)


@dataclass(frozen=True)
class SampledLight:
    """A lat-long map as the renderer needs it.

    Attributes:
        radiance: (H, W, 3), differentiable.
        sampler: Tables to draw directions by; they carry no gradient.
        turning: How the map turns with the camera; None where it stands still.
    """

    radiance: Tensor
    sampler: LatLongSampler
    turning: TurningLight | None = None

    def __post_init__(self) -> None:
        size = (self.sampler.height, self.sampler.width, 3)
        if self.radiance.shape != size:  # kernels would read beyond its end
            raise ValueError(f"light: expected radiance of the sampler's size {size}, found {tuple(self.radiance.shape)}")

    @classmethod
    def of(cls, radiance: Tensor, *, uniform_fraction: float = 0.0, turning: TurningLight | None = None) -> SampledLight:
        """A light with its sampling tables made from the current radiance."""
        return cls(radiance, LatLongSampler.build(radiance, uniform_fraction=uniform_fraction), turning)


def texel_to_direction(texel: Tensor, u: Tensor, v: Tensor, height: int, width: int) -> Tensor:
    """Directions uniform in solid angle inside the given texels; ``u``, ``v`` uniform in [0, 1): (..., 3)."""
    row, column = texel // width, texel % width
    upper, lower = torch.cos(row * (math.pi / height)), torch.cos((row + 1) * (math.pi / height))
    z = upper + (lower - upper) * u
    radius = torch.sqrt((1 - z * z).clamp_min(0))
    phi = math.pi - (column + v) * (2 * math.pi / width)
    return torch.stack([radius * torch.cos(phi), radius * torch.sin(phi), z], -1)
