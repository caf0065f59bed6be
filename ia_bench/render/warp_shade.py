"""The kernel that sums the samples of points: native code, LANES points at a time; see :mod:`ia_bench.render.kernels`."""

import warp as wp

from ia_bench.common.native import LANES, MATH, WIDTH, native
from ia_bench.material.brdf import F0

wp.set_module_options({"enable_backward": False, "fast_math": False})

_SHADE = native(
    WIDTH,
    MATH,
    """
    struct Taps {
        int a, b, c, d;
        float p, q, r, s;
        Taps(int a, int b, int c, int d, float p, float q, float r, float s) : a(a), b(b), c(c), d(d), p(p), q(q), r(r), s(s) {}
        Taps(const Taps& from) : a(from.a), b(from.b), c(from.c), d(from.d), p(from.p), q(from.q), r(from.r), s(from.s) {}
    };
    {
    #pragma clang fp contract(off)
    const auto taps_at = [within](float u, float v, int side) {  // as bilinear_taps of ia_bench.material.warp_textures
        const float column = u * (float)side - 0.5f, row = (1.0f - v) * (float)side - 0.5f;
        const float left = ::floorf(column), top = ::floorf(row), x = column - left, y = row - top;
        const int c0 = within((int)left, side), c1 = within((int)left + 1, side);
        const int r0 = within((int)top, side) * side, r1 = within((int)top + 1, side) * side;
        return Taps(r0 + c0, r0 + c1, r1 + c0, r1 + c1, (1.0f - y) * (1.0f - x), (1.0f - y) * x, y * (1.0f - x), y * x);
    };
    const auto fetch = [](const float* texture, Taps at, int channels, int c) {
        return at.p * texture[channels * at.a + c] + at.q * texture[channels * at.b + c] + at.r * texture[channels * at.c + c]
            + at.s * texture[channels * at.d + c];
    };
    const auto numbers = [](const auto& vectors) { return (const float*)vectors.data; };
    const int begin = item * lanes;
    int which[lanes];
    float metal[lanes], passed[lanes], u[lanes], v[lanes];
    float irradiance[3][lanes], base[3][lanes], grazing[3][lanes], base_of_object[3][lanes], grazing_of_object[3][lanes];
    for (int i = 0; i < lanes; ++i) {
        which[i] = begin + i < total ? begin + i : total - 1;
        u[i] = numbers(uvs)[2 * which[i]];
        v[i] = numbers(uvs)[2 * which[i] + 1];
        metal[i] = 0.0f;
        passed[i] = 1.0f;
        for (int c = 0; c < 3; ++c)
            irradiance[c][i] = base[c][i] = grazing[c][i] = base_of_object[c][i] = grazing_of_object[c][i] = 0.0f;
    }
    for (int k = 0; k < 2 * count; ++k)
        for (int i = 0; i < lanes; ++i) {
            const int place = 2 * count * which[i] + k, texel = texels.data[place];
            const bool seen = texel >= 0, counts = texel != -1;  // below -1: in no sight, but the control has it
            const float* term = numbers(terms) + 4 * place;
            const float lobe = term[1] * (1.0f - term[3]), edge = term[1] * term[3];
            for (int c = 0; c < 3; ++c) {
                const float incoming = numbers(radiance)[3 * (seen ? texel : counts ? -2 - texel : 0) + c];
                irradiance[c][i] += counts ? incoming * term[0] : 0.0f;
                base[c][i] += seen ? incoming * lobe : 0.0f;
                grazing[c][i] += seen ? incoming * edge : 0.0f;
            }
        }
    if (steady.shape[0] > 0)
        for (int i = 0; i < lanes; ++i)
            for (int c = 0; c < 3; ++c) irradiance[c][i] += numbers(steady)[3 * which[i] + c];
    if (atlas_side > 0) {
        for (int i = 0; i < lanes; ++i) {
            const Taps taps = taps_at(u[i], v[i], atlas_side);
            const int start = firsts.shape[0] > 0 ? firsts.data[which[i]] : 0;
            const float front = fronts.data[which[i]], *from = numbers(arriving);
            for (int c = 0; c < 3; ++c) {
                irradiance[c][i] += from[3 * (start + atlas.data[taps.a]) + c] * (taps.p * front);
                irradiance[c][i] += from[3 * (start + atlas.data[taps.b]) + c] * (taps.q * front);
                irradiance[c][i] += from[3 * (start + atlas.data[taps.c]) + c] * (taps.r * front);
                irradiance[c][i] += from[3 * (start + atlas.data[taps.d]) + c] * (taps.s * front);
            }
        }
        for (int k = 0; k < count; ++k)
            for (int i = 0; i < lanes; ++i) {
                const int place = count * which[i] + k, texel = seen.data[place];
                const float* term = numbers(terms) + 4 * (place + count * (which[i] + 1));
                const float value = term[1] * boosts.data[place];
                for (int c = 0; c < 3; ++c) {
                    const float incoming = numbers(leaving)[3 * (texel >= 0 ? texel : 0) + c] * value;
                    base_of_object[c][i] += texel >= 0 ? incoming * (1.0f - term[3]) : 0.0f;
                    grazing_of_object[c][i] += texel >= 0 ? incoming * term[3] : 0.0f;
                }
            }
    }
    if (metallic_side > 0)
        for (int i = 0; i < lanes; ++i) metal[i] = fetch(metallic.data, taps_at(u[i], v[i], metallic_side), 1, 0);
    if (coat_side > 0)
        for (int i = 0; i < lanes; ++i) {  // where the table is looked up: as coat_taps of ia_bench.render.kernels
            const float rough = fetch(roughness.data, taps_at(u[i], v[i], roughness_side), 1, 0);
            const float *normal = numbers(normals) + 3 * which[i], *view = numbers(views) + 3 * which[i];
            const float cosine = Vec(normal[0], normal[1], normal[2]).dot(Vec(view[0], view[1], view[2]));
            const float last = (float)(coat_side - 1), x = (cosine * last + 0.5f) / (float)coat_side;
            passed[i] = 1.0f - fetch(coat.data, taps_at(x, 1.0f - (rough * last + 0.5f) / (float)coat_side, coat_side), 1, 0);
        }
    float results[4][3][lanes];
    for (int i = 0; i < lanes; ++i) {
        const Taps taps = taps_at(u[i], v[i], albedo_side);
        for (int c = 0; c < 3; ++c) {
            const float colour = fetch(numbers(albedo), taps, 3, c), at_normal = ${F0}f * (1.0f - metal[i]) + metal[i] * colour;
            results[0][c][i] = colour * irradiance[c][i] * ((1.0f - metal[i]) * passed[i] / pi);
            results[1][c][i] = at_normal * base[c][i] + grazing[c][i];
            results[2][c][i] = at_normal * base_of_object[c][i] + grazing_of_object[c][i];
            results[3][c][i] = colour;
        }
    }
    wp::vec3* into[4] = {diffuse.data, specular.data, mirrored.data, albedos.data};
    for (int part = 0; part < 4; ++part)
        for (int i = 0; i < lanes && begin + i < total; ++i)
            into[part][begin + i] = wp::vec3(results[part][0][i], results[part][1][i], results[part][2][i]);
    }
""",
    LANES=LANES,
    F0=F0,
)


@wp.func_native(_SHADE)
def _shade(
    item: int, total: int, radiance: wp.array(dtype=wp.vec3), albedo: wp.array(dtype=wp.vec3), roughness: wp.array(dtype=float),
    metallic: wp.array(dtype=float), arriving: wp.array(dtype=wp.vec3), leaving: wp.array(dtype=wp.vec3),
    steady: wp.array(dtype=wp.vec3), albedo_side: int,
    roughness_side: int, metallic_side: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2), fronts: wp.array(dtype=float), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
    boosts: wp.array2d(dtype=float), seen: wp.array2d(dtype=int), firsts: wp.array(dtype=int), count: int,
    atlas: wp.array(dtype=int), atlas_side: int,
    coat: wp.array(dtype=float), coat_side: int, diffuse: wp.array(dtype=wp.vec3), specular: wp.array(dtype=wp.vec3),
    mirrored: wp.array(dtype=wp.vec3), albedos: wp.array(dtype=wp.vec3),
): ...  # fmt: skip


@wp.kernel
def shade(
    first: int, radiance: wp.array(dtype=wp.vec3), albedo: wp.array(dtype=wp.vec3), roughness: wp.array(dtype=float),
    metallic: wp.array(dtype=float), arriving: wp.array(dtype=wp.vec3), leaving: wp.array(dtype=wp.vec3),
    steady: wp.array(dtype=wp.vec3), albedo_side: int,
    roughness_side: int, metallic_side: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2), fronts: wp.array(dtype=float), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
    boosts: wp.array2d(dtype=float), seen: wp.array2d(dtype=int), firsts: wp.array(dtype=int), count: int,
    atlas: wp.array(dtype=int), atlas_side: int,
    coat: wp.array(dtype=float), coat_side: int, diffuse: wp.array(dtype=wp.vec3), specular: wp.array(dtype=wp.vec3),
    mirrored: wp.array(dtype=wp.vec3), albedos: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Sum the weighted samples of LANES points, on a GPU of one. A side of 0 means that there is no such texture, atlas or table.

    ``seen`` says which row of ``leaving`` each direction by the BRDF ends on, -1 for none, and ``firsts``, if it is there, which
    row of ``arriving`` is the first of the atlas for a point. ``steady``, if it is there, is irradiance that no sample estimates.
    """
    _shade(
        first + wp.tid(), normals.shape[0], radiance, albedo, roughness, metallic, arriving, leaving, steady, albedo_side,
        roughness_side, metallic_side, normals, views, uvs, fronts, texels, terms, boosts, seen, firsts, count, atlas, atlas_side,
        coat, coat_side, diffuse, specular, mirrored, albedos,
    )  # fmt: skip
