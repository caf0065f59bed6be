"""The Monte-Carlo estimator of the paper's equation 3 as Warp kernels: light and BRDF samples joined by the balance heuristic.

Samples are drawn by :mod:`ia_bench.render.warp_draw` and summed by :mod:`ia_bench.render.warp_shade`. Directions, densities and
visibility carry no gradient: gradients flow through the radiance of the light, the albedo, and the BRDF's value only ("detached"
sampling).

:func:`shade_adjoint` is written by hand: what Warp 1.19 derives of the sum takes several times as long and loses a part of
the gradient of the albedo. Tests compare it with torch's.
"""

import warp as wp

from ia_bench.common.warp_math import unit
from ia_bench.material.brdf import F0, MIN_COSINE
from ia_bench.material.warp_textures import Taps, add_at, bilinear_taps, fetch_at

wp.set_module_options({"enable_backward": False, "fast_math": False})

_MIN_COSINE = wp.constant(wp.float32(MIN_COSINE))


@wp.kernel
def interpolate(
    first: int, faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2), cameras: wp.array(dtype=wp.vec3),
    corners: wp.array2d(dtype=wp.vec3), corner_uvs: wp.array2d(dtype=wp.vec2), geometrics: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3), normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    turned_geometrics: wp.array(dtype=wp.vec3), uvs: wp.array(dtype=wp.vec2), flags: wp.array2d(dtype=wp.uint8),
):  # fmt: skip
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
    first: int, faces: wp.array2d(dtype=int), barycentrics: wp.array2d(dtype=wp.vec2), corner_uvs: wp.array2d(dtype=wp.vec2),
    texture: wp.array3d(dtype=float), found: wp.array2d(dtype=float),
):  # fmt: skip
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
    first: int, directions: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.int64), barycentrics: wp.array(dtype=wp.vec2),
    geometrics: wp.array(dtype=wp.vec3), corner_uvs: wp.array2d(dtype=wp.vec2), atlas: wp.array(dtype=int), side: int,
    texels: wp.array(dtype=int),
):  # fmt: skip
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


_PI = wp.constant(wp.float32(wp.pi))
_DIELECTRIC = wp.constant(wp.vec3(F0, F0, F0))


@wp.func
def coat_taps(rough: float, cosine: float, side: int) -> Taps:
    """Where the table of :func:`ia_bench.material.brdf.coat_reflectance` is looked up: its entries are texel centres."""
    last = float(side - 1)
    return bilinear_taps(wp.vec2((cosine * last + 0.5) / float(side), 1.0 - (rough * last + 0.5) / float(side)), side, side)


@wp.kernel
def shade_adjoint(
    first: int, radiance: wp.array(dtype=wp.vec3), albedo: wp.array(dtype=wp.vec3), roughness: wp.array(dtype=float),
    metallic: wp.array(dtype=float), arriving: wp.array(dtype=wp.vec3), leaving: wp.array(dtype=wp.vec3),
    steady: wp.array(dtype=wp.vec3), albedo_side: int,
    roughness_side: int, metallic_side: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2), fronts: wp.array(dtype=float), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
    boosts: wp.array2d(dtype=float), seen: wp.array2d(dtype=int), firsts: wp.array(dtype=int), count: int,
    atlas: wp.array(dtype=int), atlas_side: int,
    coat: wp.array(dtype=float), coat_side: int, of_diffuse: wp.array(dtype=wp.vec3), of_specular: wp.array(dtype=wp.vec3),
    of_mirrored: wp.array(dtype=wp.vec3), of_albedo: wp.array(dtype=wp.vec3), of_radiance: wp.array(dtype=wp.vec3),
    of_albedos: wp.array(dtype=wp.vec3), of_roughness: wp.array(dtype=float), of_metallic: wp.array(dtype=float),
    of_arriving: wp.array(dtype=wp.vec3), of_leaving: wp.array(dtype=wp.vec3), of_steady: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Add to the gradients of all that the sum is differentiable in, by the gradients of its results.

    Written for results R = colour * irradiance * q + at_normal * base + grazing, with q = (1 - metallic) * passed / pi, of
    which ``irradiance``, ``base`` and ``grazing`` are sums over samples.
    """
    n = first + wp.tid()
    uv = uvs[n]
    colour_taps = bilinear_taps(uv, albedo_side, albedo_side)
    rough_taps = bilinear_taps(uv, roughness_side, roughness_side)
    colour = fetch_at(albedo, colour_taps)
    rough = fetch_at(roughness, rough_taps)
    metal = float(0.0)
    if metallic_side > 0:
        metal = fetch_at(metallic, bilinear_taps(uv, metallic_side, metallic_side))
    at_normal = _DIELECTRIC * (1.0 - metal) + metal * colour
    passed = float(1.0)
    passed_slope = float(0.0)
    if coat_side > 0:
        # At the last row of the table both of its neighbours would be that row, and the slope 0.
        taps = coat_taps(wp.min(rough, 1.0 - 1e-5), wp.dot(normals[n], views[n]), coat_side)
        passed = 1.0 - fetch_at(coat, taps)
        right = taps.weight[1] + taps.weight[3]
        upper = (1.0 - right) * coat[taps.index[0]] + right * coat[taps.index[1]]
        lower = (1.0 - right) * coat[taps.index[2]] + right * coat[taps.index[3]]
        passed_slope = (upper - lower) * float(coat_side - 1)
    q = (1.0 - metal) * passed / _PI
    of_irradiance = wp.cw_mul(colour, of_diffuse[n]) * q
    of_grazing = of_specular[n]
    of_base = wp.cw_mul(at_normal, of_grazing)
    irradiance = wp.vec3(0.0, 0.0, 0.0)
    of_at_normal = wp.vec3(0.0, 0.0, 0.0)
    of_alpha = float(0.0)
    for k in range(2 * count):
        texel = texels[n, k]
        if texel >= 0:
            incoming = radiance[texel]
            term = terms[n, k]
            of_lobe = of_base * (1.0 - term[3]) + of_grazing * term[3]
            wp.atomic_add(of_radiance, texel, of_irradiance * term[0] + of_lobe * term[1])
            of_alpha += wp.dot(incoming, of_lobe) * term[2]
            irradiance += incoming * term[0]
            of_at_normal += incoming * (term[1] * (1.0 - term[3]))
        elif texel < -1:
            wp.atomic_add(of_radiance, -2 - texel, of_irradiance * terms[n, k][0])
            irradiance += radiance[-2 - texel] * terms[n, k][0]
    if steady.shape[0] > 0:
        irradiance += steady[n]
        of_steady[n] = of_irradiance
    of_at_normal = wp.cw_mul(of_at_normal, of_grazing)
    if atlas_side > 0:
        taps = bilinear_taps(uv, atlas_side, atlas_side)
        start = int(0)
        if firsts.shape[0] > 0:
            start = firsts[n]
        for t in range(4):
            share = taps.weight[t] * fronts[n]
            irradiance += arriving[start + atlas[taps.index[t]]] * share
            wp.atomic_add(of_arriving, start + atlas[taps.index[t]], of_irradiance * share)
        of_grazing = of_mirrored[n]
        of_base = wp.cw_mul(at_normal, of_grazing)
        for k in range(count):
            texel = seen[n, k]
            if texel >= 0:
                incoming = leaving[texel] * boosts[n, k]
                term = terms[n, count + k]
                of_lobe = of_base * (1.0 - term[3]) + of_grazing * term[3]
                wp.atomic_add(of_leaving, texel, of_lobe * (term[1] * boosts[n, k]))
                of_alpha += wp.dot(incoming, of_lobe) * term[2]
                of_at_normal += wp.cw_mul(incoming, of_grazing) * (term[1] * (1.0 - term[3]))
    of_q = wp.dot(of_diffuse[n], wp.cw_mul(colour, irradiance)) / _PI
    of_rough = 2.0 * rough * of_alpha + of_q * (1.0 - metal) * passed_slope
    add_at(of_roughness, rough_taps, of_rough)
    if metallic_side > 0:
        of_metal = wp.dot(of_at_normal, colour - _DIELECTRIC) - of_q * passed
        add_at(of_metallic, bilinear_taps(uv, metallic_side, metallic_side), of_metal)
    add_at(of_albedos, colour_taps, of_albedo[n] + wp.cw_mul(irradiance, of_diffuse[n]) * q + of_at_normal * metal)
