"""Warp kernels that find points of a surface: those that a camera sees, and those on which rays end."""

import warp as wp

from ia_bench.common.warp_math import unit
from ia_bench.material.brdf import MIN_COSINE

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

    Of a triangle's ``corners`` the first three are positions, the others normals; of a point's ``flags`` the first says whether its
    front is seen, the second whether its normal had to be bent.
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
    uvs[n] = a * corner_uvs[face, 0] + b[0] * corner_uvs[face, 1] + b[1] * corner_uvs[face, 2]
    flags[n, 0] = wp.where(side > 0.0, wp.uint8(1), wp.uint8(0))
    flags[n, 1] = bent


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
            b = barycentrics[n]
            uv = (1.0 - b[0] - b[1]) * corner_uvs[face, 0] + b[0] * corner_uvs[face, 1] + b[1] * corner_uvs[face, 2]
            column = wp.clamp(int(uv[0] * float(side)), 0, side - 1)
            row = wp.clamp(int((1.0 - uv[1]) * float(side)), 0, side - 1)
            texel = atlas[row * side + column]
    texels[n] = texel
