"""The kernel that draws directions of light: native code, LANES points of the surface at a time.

Half of the samples of a point follow the light, half the visible GGX normals. Each half comes from one lattice per pixel, which a
Cranley-Patterson rotation moves: its first coordinate is stratified over all the samples of the pixel, and each sample alone is
uniform, so every point of the pixel has an unbiased estimate whatever its share of the samples.
"""

import warp as wp

from ia_bench.common.native import LANES, MATH, WIDTH, native
from ia_bench.light.warp_latlong import DIRECTIONS, SAMPLING, Tables
from ia_bench.material.brdf import GOLDEN, PLASTIC
from ia_bench.material.warp_brdf import BRDF
from ia_bench.material.warp_textures import bilinear_taps, fetch_at

wp.set_module_options({"enable_backward": False, "fast_math": False})


_DRAW = native(
    WIDTH,
    MATH,
    DIRECTIONS,
    SAMPLING,
    BRDF,
    """
    const int begin = item * lanes, stride = points * parts;
    const double spacing = 1.0 / ((double)stride * (double)count);
    int which[lanes], pixel[lanes], first[lanes], cell[lanes], texel[lanes];
    float x[lanes], y[lanes], z[lanes], cosine[lanes], value[lanes], slope[lanes], grazing[lanes], boost[lanes];
    for (int i = 0; i < lanes; ++i) {
        which[i] = begin + i < total ? begin + i : total - 1;
        pixel[i] = which[i] / points;
        first[i] = which[i] - pixel[i] * points + points * part;
        const wp::vec3 normal = normals.data[which[i]];
        cell[i] = normal_bin(Vec(normal[0], normal[1], normal[2]));
    }
    const auto point_of = [&](int n) {
        const wp::vec3 normal = normals.data[n], view = views.data[n];
        return seen_point(Vec(normal[0], normal[1], normal[2]), Vec(view[0], view[1], view[2]), alphas.data[n]);
    };
    const auto keep = [&](int i, Seen point, Vec direction, int drawn) {
        const float cos_i = point.normal.dot(direction);
        const Lobe lobe = lobe_towards(point, direction, cos_i);
        const float pdf = most(density(cell[i], drawn) + lobe.pdf, 1.0e-12f), weight = 1.0f / ((float)count * pdf);
        texel[i] = cos_i > 0.0f ? drawn : -1;
        x[i] = direction.x;
        y[i] = direction.y;
        z[i] = direction.z;
        cosine[i] = cos_i * weight;
        value[i] = lobe.value * weight;
        slope[i] = lobe.slope * weight;
        grazing[i] = lobe.grazing;
        boost[i] = pdf / most(lobe.pdf, 1.0e-12f);
    };
    for (int k = 0; k < 2 * count; ++k) {
        const bool by_light = k < count;
        const int entry = by_light ? k : k - count;
        double u[lanes];
        float v[lanes], w[lanes], around[lanes];
        for (int i = 0; i < lanes; ++i) {
            const double index = first[i] + stride * entry;
            const double* rotation = rotations.data[(by_light ? 0 : pixels) + pixel[i]].c;
            u[i] = fraction(rotation[0] + index * spacing);
            around[i] = (float)u[i];
            v[i] = (float)fraction(rotation[1] + index * $GOLDEN);
            w[i] = (float)fraction(rotation[2] + index * $PLASTIC);
        }
        if (by_light) {
            int drawn[lanes];
            sample_texels(cell, u, drawn);
            for (int i = 0; i < lanes; ++i)
                keep(i, point_of(which[i]), texel_to_direction(drawn[i], v[i], w[i], tables.heights.data, tables.width), drawn[i]);
        } else {
            for (int i = 0; i < lanes; ++i) {
                const Seen point = point_of(which[i]);
                const Vec direction = sample_visible_ggx(point, around[i], v[i]);
                keep(i, point, direction, direction_to_texel(direction, tables.height, tables.width));
            }
        }
        for (int i = 0; i < lanes && begin + i < total; ++i) {
            const int n = begin + i, place = 2 * count * n + k;
            texels.data[place] = hit.data[n] ? texel[i] : -1;
            if (!hit.data[n]) continue;
            directions.data[place] = wp::vec3(x[i], y[i], z[i]);
            if (texel[i] < 0) continue;
            terms.data[place] = wp::vec4(cosine[i], value[i], slope[i], grazing[i]);
            if (!by_light) boosts.data[count * n + entry] = boost[i];
        }
    }
""",
    LANES=LANES,
    GOLDEN=GOLDEN,
    PLASTIC=PLASTIC,
)


@wp.func_native(_DRAW)
def _draw(
    item: int, total: int, hit: wp.array(dtype=wp.uint8), normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    alphas: wp.array(dtype=float), rotations: wp.array2d(dtype=wp.vec3d), pixels: int, tables: Tables, points: int, count: int,
    part: int, parts: int, directions: wp.array2d(dtype=wp.vec3), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
    boosts: wp.array2d(dtype=float),
): ...  # fmt: skip


@wp.kernel
def draw(
    first: int, lanes: int, hit: wp.array(dtype=wp.uint8), normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2), roughness: wp.array(dtype=float), roughness_side: int, rotations: wp.array2d(dtype=wp.vec3d),
    tables: Tables, points: int, count: int, part: int, parts: int, alphas: wp.array(dtype=float),
    directions: wp.array2d(dtype=wp.vec3), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
    boosts: wp.array2d(dtype=float),
):  # fmt: skip
    """Draw ``count`` directions by each technique for each of ``lanes`` points, LANES on a CPU; a pixel has ``points`` of them.

    ``texels`` says where a direction ends in the light, -1 below the horizon and where the camera sees nothing. ``terms`` holds
    the cosine, the lobe's value and its slope in alpha, each times the balance heuristic's weight
    1 / (n_light p_light + n_brdf p_brdf), and the lobe's grazing part. ``boosts`` is the factor from the
    weight of a direction by the BRDF to the one that it would have alone, for what it sees of the object. A lattice may be dealt
    out to several ``parts``: this one takes every such entry of each point. ``alphas`` (N,) is a place to work in.
    """
    item = first + wp.tid()
    total = normals.shape[0]
    for n in range(item * lanes, wp.min((item + 1) * lanes, total)):
        alpha = float(1.0)
        if hit[n] != wp.uint8(0):
            rough = fetch_at(roughness, bilinear_taps(uvs[n], roughness_side, roughness_side))
            alpha = rough * rough
        alphas[n] = alpha
    _draw(
        item, total, hit, normals, views, alphas, rotations, rotations.shape[1], tables, points, count, part, parts, directions,
        texels, terms, boosts,
    )  # fmt: skip
