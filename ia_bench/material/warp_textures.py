"""Bilinear look-ups in textures as functions of Warp kernels, and the kernels of :func:`ia_bench.material.textures.fetch`."""

from typing import Any

import warp as wp


@wp.struct
class Taps:
    """The four texels around a point of a texture, by flat index, and their weights."""

    index: wp.vec4i
    weight: wp.vec4


@wp.func
def bilinear_taps(uv: wp.vec2, height: int, width: int) -> Taps:
    """The four texels around ``uv`` and their bilinear weights; beyond the border the nearest texel is repeated."""
    column = uv[0] * float(width) - 0.5
    row = (1.0 - uv[1]) * float(height) - 0.5
    left = wp.floor(column)
    top = wp.floor(row)
    right_weight = column - left
    bottom_weight = row - top
    c0 = wp.clamp(int(left), 0, width - 1)
    c1 = wp.clamp(int(left) + 1, 0, width - 1)
    r0 = wp.clamp(int(top), 0, height - 1)
    r1 = wp.clamp(int(top) + 1, 0, height - 1)
    taps = Taps()
    taps.index = wp.vec4i(r0 * width + c0, r0 * width + c1, r1 * width + c0, r1 * width + c1)
    taps.weight = wp.vec4(
        (1.0 - bottom_weight) * (1.0 - right_weight),
        (1.0 - bottom_weight) * right_weight,
        bottom_weight * (1.0 - right_weight),
        bottom_weight * right_weight,
    )
    return taps


@wp.func
def fetch_at(texture: wp.array(dtype=Any), taps: Taps):
    """What a flat texture of one or three channels holds at a point."""
    i = taps.index
    w = taps.weight
    return w[0] * texture[i[0]] + w[1] * texture[i[1]] + w[2] * texture[i[2]] + w[3] * texture[i[3]]


@wp.func
def add_at(texture: wp.array(dtype=Any), taps: Taps, value: Any):
    """The transpose of :func:`fetch_at`."""
    for t in range(4):
        wp.atomic_add(texture, taps.index[t], taps.weight[t] * value)


@wp.kernel
def look_up(first: int, uvs: wp.array(dtype=wp.vec2), texture: wp.array3d(dtype=float), found: wp.array2d(dtype=float)):
    """All channels of a texture at a point."""
    n = first + wp.tid()
    width = texture.shape[1]
    taps = bilinear_taps(uvs[n], texture.shape[0], width)
    for c in range(texture.shape[2]):
        total = float(0.0)
        for t in range(4):
            row = taps.index[t] // width
            total += taps.weight[t] * texture[row, taps.index[t] - row * width, c]
        found[n, c] = total


@wp.kernel
def look_up_adjoint(first: int, uvs: wp.array(dtype=wp.vec2), values: wp.array2d(dtype=float), texture: wp.array3d(dtype=float)):
    """The transpose of :func:`look_up`."""
    n = first + wp.tid()
    width = texture.shape[1]
    taps = bilinear_taps(uvs[n], texture.shape[0], width)
    for t in range(4):
        row = taps.index[t] // width
        for c in range(texture.shape[2]):
            wp.atomic_add(texture, row, taps.index[t] - row * width, c, taps.weight[t] * values[n, c])
