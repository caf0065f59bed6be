"""What steps do with whole textures: the smoothness term of equation 5 with its gradient, and a texture added at twice its size."""

import warp as wp

from ia_bench.material.warp_textures import bilinear_taps


@wp.kernel(enable_backward=False)
def differences(
    first: int,
    pixels: wp.array(dtype=wp.int64),
    neighbours: wp.array2d(dtype=int),
    similarities: wp.array2d(dtype=float),
    uvs: wp.array(dtype=wp.vec2),
    texture: wp.array(dtype=float),
    side: int,
    channels: int,
    price: float,
    totals: wp.array(dtype=float),
    gradient: wp.array(dtype=float),
):
    """The loss of a pixel's two pairs, ``price`` times similarity times the sum of absolute differences; its gradient."""
    n = first + wp.tid()
    here = int(pixels[n])
    total = float(0.0)
    for pair in range(2):
        similarity = price * similarities[here, pair]
        if similarity > 0.0:
            a = bilinear_taps(uvs[here], side, side)
            b = bilinear_taps(uvs[neighbours[here, pair]], side, side)
            a_index = a.index * channels
            b_index = b.index * channels
            for c in range(channels):
                difference = float(0.0)
                for t in range(4):
                    difference += a.weight[t] * texture[a_index[t] + c] - b.weight[t] * texture[b_index[t] + c]
                total += similarity * wp.abs(difference)
                if difference != 0.0:
                    slope = similarity * wp.sign(difference)
                    for t in range(4):
                        wp.atomic_add(gradient, a_index[t] + c, slope * a.weight[t])
                        wp.atomic_add(gradient, b_index[t] + c, -slope * b.weight[t])
    totals[n] = total


_ADD_DOUBLED_ROW = """
    const float down = 0.5f * row > 0.25f ? 0.5f * row - 0.25f : 0.0f;
    const int top = (row + 1) / 2 - 1 > 0 ? (row + 1) / 2 - 1 : 0, bottom = top + 1 < height ? top + 1 : top;
    const float below = down - top, above = 1.0f - below;
    const float* upper = coarse.data + top * width * channels;
    const float* lower = coarse.data + bottom * width * channels;
    float* sums = fine.data + row * 2 * width * channels;
    const int end = width * channels;
    for (int c = 0; c < channels; ++c) {
        const int before = wraps ? end - channels + c : c;
        float here = above * upper[c] + below * lower[c], left = above * upper[before] + below * lower[before];
        for (int k = c; k < end; k += channels) {
            const int next = k + channels < end ? k + channels : wraps ? c : k;
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
    coarse: wp.array(dtype=float), height: int, width: int, channels: int, wraps: int, row: int, fine: wp.array(dtype=float)
): ...  # fmt: skip


@wp.kernel(enable_backward=False)
def add_doubled(
    first: int, coarse: wp.array(dtype=float), height: int, width: int, channels: int, wraps: int, fine: wp.array(dtype=float)
):  # fmt: skip
    """A row of an image to which one of half its resolution, (height, width, channels), is added bilinearly; both lie flat.

    ``wraps``: whether the last column lies beside the first one, as in a lat-long map; else the border's values go on beyond it.
    """
    _add_doubled_row(coarse, height, width, channels, wraps, first + wp.tid(), fine)
