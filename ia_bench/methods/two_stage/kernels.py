"""What steps do with whole textures: the smoothness term of equation 5 with its gradient, and a texture added at twice its size."""

import warp as wp

from ia_bench.material.warp_textures import bilinear_taps


@wp.kernel(enable_backward=False)
def differences(
    first: int,
    pixels: wp.array(dtype=wp.int64),
    neighbours: wp.array2d(dtype=wp.int64),
    similarities: wp.array2d(dtype=float),
    uvs: wp.array(dtype=wp.vec2),
    texture: wp.array3d(dtype=float),
    totals: wp.array(dtype=float),
    gradient: wp.array3d(dtype=float),
):
    """Of a pixel's two pairs: the similarity times the sum over channels of the absolute difference, and its gradient."""
    n = first + wp.tid()
    here = int(pixels[n])
    width = texture.shape[1]
    total = float(0.0)
    for pair in range(2):
        similarity = similarities[here, pair]
        if similarity > 0.0:
            a = bilinear_taps(uvs[here], texture.shape[0], width)
            b = bilinear_taps(uvs[int(neighbours[here, pair])], texture.shape[0], width)
            for c in range(texture.shape[2]):
                difference = float(0.0)
                for t in range(4):
                    row = a.index[t] // width
                    difference += a.weight[t] * texture[row, a.index[t] - row * width, c]
                    row = b.index[t] // width
                    difference -= b.weight[t] * texture[row, b.index[t] - row * width, c]
                total += similarity * wp.abs(difference)
                slope = similarity * wp.sign(difference)
                if difference != 0.0:
                    for t in range(4):
                        row = a.index[t] // width
                        wp.atomic_add(gradient, row, a.index[t] - row * width, c, slope * a.weight[t])
                        row = b.index[t] // width
                        wp.atomic_add(gradient, row, b.index[t] - row * width, c, -slope * b.weight[t])
    totals[n] = total


_ADD_DOUBLED_ROW = """
    const float down = 0.5f * row > 0.25f ? 0.5f * row - 0.25f : 0.0f;
    const int top = (row + 1) / 2 - 1 > 0 ? (row + 1) / 2 - 1 : 0, bottom = top + 1 < height ? top + 1 : top;
    const float below = down - top, above = 1.0f - below;
    const float* upper = coarse.data + top * width * channels;
    const float* lower = coarse.data + bottom * width * channels;
    float* sums = fine.data + row * 2 * width * channels;
    for (int c = 0; c < channels; ++c) {
        float here = above * upper[c] + below * lower[c], left = here;
        for (int k = c; k < width * channels; k += channels) {
            const int next = k + channels < width * channels ? k + channels : k;
            const float right = above * upper[next] + below * lower[next];
            sums[2 * k - c] += 0.75f * here + 0.25f * left;
            sums[2 * k - c + channels] += 0.75f * here + 0.25f * right;
            left = here;
            here = right;
        }
    }
"""


@wp.func_native(_ADD_DOUBLED_ROW)
def _add_doubled_row(
    coarse: wp.array(dtype=float), height: int, width: int, channels: int, row: int, fine: wp.array(dtype=float)
): ...  # fmt: skip


@wp.kernel(enable_backward=False)
def add_doubled(
    first: int, coarse: wp.array(dtype=float), height: int, width: int, channels: int, fine: wp.array(dtype=float)
):  # fmt: skip
    """A row of an image to which one of half its resolution, (height, width, channels), is added bilinearly; both lie flat."""
    _add_doubled_row(coarse, height, width, channels, first + wp.tid(), fine)
