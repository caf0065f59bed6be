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
        const int about = (int)(((float)texel + 0.5f) / (float)width);  // floats: vector units do not divide whole numbers
        const int row = about + (texel >= (about + 1) * width) - (texel < about * width);  // of large maps rounding is one row off
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
    // Of each lane the first place from low on whose entry is above value, of so many that are left, or the one behind them. All
    // lanes take a step together, and without a jump: of a step alone most of the time is waiting for its entry.
    const auto first_above = [](const double* sorted, int* low, int* left, const double* value) {
        for (int longest = 1; longest > 0;) {
            longest = 0;
            for (int i = 0; i < lanes; ++i) {
                const int half = (left[i] + 1) >> 1, last = low[i] + half - 1;
                low[i] = sorted[last > 0 ? last : 0] > value[i] ? low[i] : low[i] + half;
                left[i] -= half;
                longest = longest > left[i] ? longest : left[i];
            }
        }
    };
    // Texels for the normals of cells, u uniform in [0, 1).
    const auto sample_texels = [&tables, first_above, within](const int* cell, const double* u, int* texel) {
        const int count = 2 * tables.blocks;
        int left[lanes], half[lanes];
        double target[lanes];
        for (int i = 0; i < lanes; ++i) {
            const int* guide = tables.guide.data + cell[i] * ($GUIDE + 1) + within((int)(u[i] * $GUIDE), $GUIDE);
            const int end = (cell[i] + 1) * count;
            target[i] = (double)cell[i] + u[i];
            texel[i] = guide[0];
            left[i] = (guide[1] < end ? guide[1] : end) - guide[0];
        }
        first_above(tables.entries.data, texel, left, target);
        for (int i = 0; i < lanes; ++i) {
            const int entry = within(texel[i] - 1 - cell[i] * count, count);
            const double *entries = tables.entries.data + cell[i] * count + entry, *edges = tables.edges.data + entry;
            const double below = 1.0 - 1.0 / 1099511627776.0;
            double rest = (target[i] - entries[0]) / (entries[1] - entries[0]);  // uniform again, inside the entry
            rest = rest < 0.0 ? 0.0 : rest < below ? rest : below;
            target[i] = edges[0] + rest * (edges[1] - edges[0]);
            const bool second = entry >= tables.blocks;
            const int block = second ? entry - tables.blocks : entry;
            half[i] = second ? (int)tables.order.shape[0] : 0;
            texel[i] = half[i] + (block > 0 ? tables.end.data[block - 1] : 0);
            left[i] = half[i] + tables.end.data[block] - 1 - texel[i];
        }
        first_above(tables.texels.data, texel, left, target);
        for (int i = 0; i < lanes; ++i) texel[i] = tables.order.data[texel[i] - half[i]];
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
