"""Warp kernels that find points of a surface: those that a camera sees, what of a texture lies there, and where rays end."""

import warp as wp

from ia_bench.common.warp_math import unit
from ia_bench.material.brdf import MIN_COSINE
from ia_bench.material.warp_textures import bilinear_taps

wp.set_module_options({"enable_backward": False})

_MIN_COSINE = wp.constant(wp.float32(MIN_COSINE))


@wp.kernel
def interpolate(
    first: int,
    faces: wp.array(dtype=int),
    barycentrics: wp.array(dtype=wp.vec2),
    cameras: wp.array(dtype=wp.vec3),
    corners: wp.array2d(dtype=wp.vec3),
    corner_uvs: wp.array2d(dtype=wp.vec2),
    geometrics: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    views: wp.array(dtype=wp.vec3),
    turned_geometrics: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2),
    flags: wp.array2d(dtype=wp.uint8),
):
    """See :class:`ia_bench.render.gbuffer.SurfaceInterpolator`.

    A triangle's first three ``corners`` are positions, the others normals. A point's first flag says whether its front is seen,
    its second whether its normal had to be bent.
    """
    n = first + wp.tid()
    face = wp.max(faces[n], 0)
    b = barycentrics[n]
    a = 1.0 - b[0] - b[1]
    position = a * corners[face, 0] + b[0] * corners[face, 1] + b[1] * corners[face, 2]
    normal = unit(a * corners[face, 3] + b[0] * corners[face, 4] + b[1] * corners[face, 5])
    view = unit(cameras[n] - position)
    geometric = geometrics[face]
    side = wp.where(wp.dot(geometric, view) >= 0.0, 1.0, -1.0)
    normal = normal * side
    cosine = wp.dot(normal, view)
    bent = wp.uint8(0)
    if cosine < _MIN_COSINE:
        normal = unit(normal + (10.0 * _MIN_COSINE - cosine) * view)
        bent = wp.where(faces[n] >= 0, wp.uint8(1), wp.uint8(0))
    positions[n] = position
    normals[n] = normal
    views[n] = view
    turned_geometrics[n] = side * geometric
    uvs[n] = uv_at(corner_uvs, face, b)
    flags[n, 0] = wp.where(side > 0.0, wp.uint8(1), wp.uint8(0))
    flags[n, 1] = bent


@wp.func
def uv_at(corner_uvs: wp.array2d(dtype=wp.vec2), face: int, b: wp.vec2) -> wp.vec2:
    """The texture coordinates of a point of a triangle."""
    return (1.0 - b[0] - b[1]) * corner_uvs[face, 0] + b[0] * corner_uvs[face, 1] + b[1] * corner_uvs[face, 2]


@wp.kernel
def average(
    first: int,
    faces: wp.array2d(dtype=int),
    barycentrics: wp.array2d(dtype=wp.vec2),
    corner_uvs: wp.array2d(dtype=wp.vec2),
    texture: wp.array3d(dtype=float),
    found: wp.array2d(dtype=float),
):
    """The mean of a texture over the points of a pixel, to which those that miss add nothing; ``found`` holds zeros before."""
    pixel = first + wp.tid()
    width = texture.shape[1]
    for point in range(faces.shape[1]):
        face = faces[pixel, point]
        if face >= 0:
            taps = bilinear_taps(uv_at(corner_uvs, face, barycentrics[pixel, point]), texture.shape[0], width)
            for t in range(4):
                row = taps.index[t] // width
                for c in range(texture.shape[2]):
                    found[pixel, c] = found[pixel, c] + taps.weight[t] * texture[row, taps.index[t] - row * width, c]
    for c in range(texture.shape[2]):
        found[pixel, c] = found[pixel, c] / float(faces.shape[1])


@wp.kernel
def land(
    first: int,
    directions: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.int64),
    barycentrics: wp.array(dtype=wp.vec2),
    geometrics: wp.array(dtype=wp.vec3),
    corner_uvs: wp.array2d(dtype=wp.vec2),
    atlas: wp.array(dtype=int),
    side: int,
    texels: wp.array(dtype=int),
):
    """See :meth:`ia_bench.render.gbuffer.SurfaceInterpolator.landed`."""
    n = first + wp.tid()
    face = int(faces[n])
    texel = int(-1)
    if face >= 0:
        if wp.dot(geometrics[face], directions[n]) < 0.0:
            uv = uv_at(corner_uvs, face, barycentrics[n])
            column = wp.clamp(int(uv[0] * float(side)), 0, side - 1)
            row = wp.clamp(int((1.0 - uv[1]) * float(side)), 0, side - 1)
            texel = atlas[row * side + column]
    texels[n] = texel
