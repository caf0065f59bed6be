"""Drawing directions from :class:`ia_bench.light.latlong.LatLongSampler` as functions of Warp kernels."""

import torch
import warp as wp

from ia_bench.common.warp_launch import launch
from ia_bench.common.warp_math import arc_cosine, arc_tangent, turned
from ia_bench.light.latlong import BIN_SIDE, LatLongSampler

GUIDE = wp.constant(256)
_GUIDE = wp.constant(wp.float64(int(GUIDE)))  # for arithmetic in float64
_PI = wp.constant(wp.float32(wp.pi))
_SIDE = wp.constant(BIN_SIDE)
_WITHIN = wp.constant(wp.float64(1 - 2**-40))


@wp.struct
class Tables:
    """The tensors of a :class:`~ia_bench.light.latlong.LatLongSampler`, for ``height`` x ``width`` texels in ``blocks`` blocks.

    ``guide`` (cells, GUIDE + 1) says which of a cell's entries is the first above 0, 1 / GUIDE, ..., 1, so that a search has little
    left to look through. ``heights`` (height + 1,): z between the rows of texels.
    """

    entries: wp.array(dtype=wp.float64)
    texels: wp.array(dtype=wp.float64)
    edges: wp.array(dtype=wp.float64)
    brightness: wp.array(dtype=wp.float32)
    share: wp.array(dtype=wp.float32)
    evenly: wp.array(dtype=wp.float32)
    bound: wp.array(dtype=wp.float32)
    order: wp.array(dtype=wp.int32)
    block: wp.array(dtype=wp.int32)
    end: wp.array(dtype=wp.int32)
    guide: wp.array2d(dtype=wp.int32)
    heights: wp.array(dtype=wp.float32)
    blocks: wp.int32
    height: wp.int32
    width: wp.int32


def tables_of(sampler: LatLongSampler) -> Tables:
    """The sampler's tensors for a kernel, without a copy, and a guide to them."""
    tables, grid = Tables(), sampler.grid
    for name in ("entries", "texels", "edges", "brightness", "share", "evenly"):
        setattr(tables, name, wp.from_torch(getattr(sampler, name)))
    for name in ("order", "block", "end", "heights"):
        setattr(tables, name, wp.from_torch(getattr(grid, name)))
    tables.bound = wp.from_torch(grid.bound.reshape(-1))
    guide = torch.empty(BIN_SIDE**2, GUIDE + 1, dtype=torch.int32, device=sampler.entries.device)
    launch(_find_guide, len(guide), sampler.entries, 2 * len(grid.end), guide, device=guide.device)
    tables.guide = wp.from_torch(guide)
    tables.blocks, tables.height, tables.width = len(grid.end), sampler.height, sampler.width
    return tables


@wp.kernel(enable_backward=False)
def _find_guide(first: int, entries: wp.array(dtype=wp.float64), count: int, guide: wp.array2d(dtype=wp.int32)):
    cell = first + wp.tid()
    place = cell * count
    for step in range(GUIDE + 1):
        value = wp.float64(cell) + wp.float64(step) / _GUIDE
        while place < (cell + 1) * count and entries[place] <= value:
            place += 1
        guide[cell, step] = place


@wp.func
def normal_bin(normal: wp.vec3) -> int:
    """The octahedral cell that a unit normal falls into; see :func:`ia_bench.light.latlong.bin_centres`."""
    folded = normal / (wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2]))
    x = folded[0]
    y = folded[1]
    if folded[2] < 0.0:
        x = (1.0 - wp.abs(folded[1])) * wp.where(folded[0] >= 0.0, 1.0, -1.0)
        y = (1.0 - wp.abs(folded[0])) * wp.where(folded[1] >= 0.0, 1.0, -1.0)
    column = wp.clamp(int((0.5 + 0.5 * x) * float(_SIDE)), 0, _SIDE - 1)
    row = wp.clamp(int((0.5 + 0.5 * y) * float(_SIDE)), 0, _SIDE - 1)
    return row * _SIDE + column


@wp.func
def first_above(sorted: wp.array(dtype=wp.float64), first: int, last: int, value: wp.float64) -> int:
    """The first place in [first, last) whose entry is above ``value``, or ``last``.

    A step moves or does not without a jump: processors guess every other such jump wrongly, which takes longer than the step.
    """
    low = int(first)
    left = int(last - first)
    while left > 0:
        half = (left + 1) >> 1
        low = wp.where(sorted[low + half - 1] > value, low, low + half)
        left -= half
    return low


@wp.func
def sample_texel(tables: Tables, cell: int, u: wp.float64) -> int:
    """A texel drawn for the normals of ``cell`` by ``u``, uniform in [0, 1)."""
    count = 2 * tables.blocks
    target = wp.float64(cell) + u
    begin = cell * count
    step = wp.min(int(u * _GUIDE), GUIDE - 1)
    found = first_above(tables.entries, tables.guide[cell, step], wp.min(tables.guide[cell, step + 1], begin + count), target)
    entry = wp.clamp(found - 1 - begin, 0, count - 1)
    place = begin + entry
    lower = tables.entries[place]
    upper = tables.entries[place + 1]
    rest = wp.clamp((target - lower) / (upper - lower), wp.float64(0.0), _WITHIN)  # uniform again, inside the entry
    lower = tables.edges[entry]
    within = lower + rest * (tables.edges[entry + 1] - lower)
    block = entry
    half = int(0)
    if entry >= tables.blocks:
        block = entry - tables.blocks
        half = tables.order.shape[0]
    begin = int(0)
    if block > 0:
        begin = tables.end[block - 1]
    return tables.order[first_above(tables.texels, half + begin, half + tables.end[block] - 1, within) - half]


@wp.func
def density(tables: Tables, cell: int, texel: int) -> float:
    """Density per steradian with which ``texel`` is drawn for the normals of ``cell``."""
    bound = tables.bound[cell * tables.blocks + tables.block[texel]]
    return bound * (tables.brightness[texel] * tables.share[cell] + tables.evenly[cell])


@wp.func
def texel_to_direction(texel: int, u: float, v: float, heights: wp.array(dtype=wp.float32), width: int) -> wp.vec3:
    """The direction at ``u``, ``v`` in [0, 1) of a texel, uniform in solid angle; ``heights`` as :class:`Tables` has them."""
    row = texel // width
    column = texel - row * width
    upper = heights[row]
    z = upper + (heights[row + 1] - upper) * u
    radius = wp.sqrt(wp.max(1.0 - z * z, 0.0))
    around = turned(0.5 - (float(column) + v) / float(width))
    return wp.vec3(radius * around[0], radius * around[1], z)


@wp.func
def direction_to_texel(direction: wp.vec3, height: int, width: int) -> int:
    """The texel that a unit direction falls into."""
    row = int(arc_cosine(wp.clamp(direction[2], -1.0, 1.0)) * (float(height) / _PI))
    column = int((_PI - arc_tangent(direction[1], direction[0])) * (float(width) / (2.0 * _PI)))
    return wp.clamp(row, 0, height - 1) * width + wp.clamp(column, 0, width - 1)
