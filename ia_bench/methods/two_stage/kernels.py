"""The smoothness term of equation 5 with its gradient, in one pass over pairs of neighbours."""

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
