"""Drawing directions from :class:`ia_bench.light.latlong.LatLongSampler`, as C++ for native code of kernels."""

import torch
import warp as wp

from ia_bench.common.native import MATH, native
from ia_bench.common.warp_launch import launch
from ia_bench.light.latlong import BIN_SIDE, LatLongSampler

GUIDE = wp.constant(256)
_GUIDE = wp.constant(wp.float64(int(GUIDE)))  # for arithmetic in float64


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


DIRECTIONS = native(
    """
    const auto normal_bin = [within](Vec normal) {  // the octahedral cell of a unit normal, ia_bench.light.latlong.bin_centres
        const Vec folded = normal * (1.0f / (::fabsf(normal.x) + ::fabsf(normal.y) + ::fabsf(normal.z)));
        const float across = (1.0f - ::fabsf(folded.y)) * (folded.x >= 0.0f ? 1.0f : -1.0f);
        const float down = (1.0f - ::fabsf(folded.x)) * (folded.y >= 0.0f ? 1.0f : -1.0f);
        const float x = folded.z < 0.0f ? across : folded.x, y = folded.z < 0.0f ? down : folded.y;
        return within((int)((0.5f + 0.5f * y) * $SIDE), $SIDE) * $SIDE + within((int)((0.5f + 0.5f * x) * $SIDE), $SIDE);
    };
    // The direction at u, v in [0, 1) of a texel, uniform in solid angle; heights as Tables have them.
    const auto texel_to_direction = [turned, most](int texel, float u, float v, const float* heights, int width) {
        const int row = (int)(((float)texel + 0.5f) / (float)width);  // which vectors have no division of whole numbers for
        const float upper = heights[row], z = upper + (heights[row + 1] - upper) * u, radius = ::sqrtf(most(1.0f - z * z, 0.0f));
        const Vec around = turned(0.5f - ((float)(texel - row * width) + v) / (float)width);
        return Vec(radius * around.x, radius * around.y, z);
    };
    const auto direction_to_texel = [arc_cosine, arc_tangent, within, most, least, pi](Vec direction, int height, int width) {
        const int row = (int)(arc_cosine(least(most(direction.z, -1.0f), 1.0f)) * ((float)height / pi));
        const int column = (int)((pi - arc_tangent(direction.y, direction.x)) * ((float)width / (2.0f * pi)));
        return within(row, height) * width + within(column, width);
    };
""",
    SIDE=BIN_SIDE,
)
SAMPLING = native(
    """
    // The first place in [first, last) whose entry is above value, or last. A step moves or does not without a jump: processors
    // guess every other such jump wrongly, which takes longer than the step.
    const auto first_above = [](const double* sorted, int first, int last, double value) {
        int low = first;
        for (int left = last - first; left > 0;) {
            const int half = (left + 1) >> 1;
            low = sorted[low + half - 1] > value ? low : low + half;
            left -= half;
        }
        return low;
    };
    const auto sample_texel = [&tables, first_above, within](int cell, double u) {  // of the normals of a cell, u uniform in [0, 1)
        const int count = 2 * tables.blocks, begin = cell * count;
        const int* guide = tables.guide.data + cell * ($GUIDE + 1) + within((int)(u * $GUIDE), $GUIDE);
        const double target = (double)cell + u, below = 1.0 - 1.0 / 1099511627776.0;
        const int last = guide[1] < begin + count ? guide[1] : begin + count;
        const int entry = within(first_above(tables.entries.data, guide[0], last, target) - 1 - begin, count);
        const double *entries = tables.entries.data + begin + entry, *edges = tables.edges.data + entry;
        double rest = (target - entries[0]) / (entries[1] - entries[0]);  // uniform again, inside the entry
        rest = rest < 0.0 ? 0.0 : rest < below ? rest : below;
        const bool second = entry >= tables.blocks;
        const int block = second ? entry - tables.blocks : entry, half = second ? (int)tables.order.shape[0] : 0;
        const int first = half + (block > 0 ? tables.end.data[block - 1] : 0), end = half + tables.end.data[block] - 1;
        return tables.order.data[first_above(tables.texels.data, first, end, edges[0] + rest * (edges[1] - edges[0])) - half];
    };
    const auto density = [&tables](int cell, int texel) {  // per steradian, with which a texel is drawn for the normals of a cell
        const float bound = tables.bound.data[cell * tables.blocks + tables.block.data[texel]];
        return bound * (tables.brightness.data[texel] * tables.share.data[cell] + tables.evenly.data[cell]);
    };
""",
    GUIDE=int(GUIDE),
)


@wp.func_native(MATH + DIRECTIONS + "return direction_to_texel(Vec(direction[0], direction[1], direction[2]), height, width);")
def direction_to_texel(direction: wp.vec3, height: int, width: int) -> int:
    """The texel that a unit direction falls into."""
    ...
