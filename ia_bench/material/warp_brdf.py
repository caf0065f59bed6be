"""The BRDF of :mod:`ia_bench.material.brdf` as C++ for native code of kernels; tests compare the two.

``Seen`` is a surface point as a camera sees it, which all of its samples share: ``local`` is the view in the frame (tangent,
bitangent, normal) of Duff et al. 2017, stretched by ``alpha`` and unit again, ``cosine`` that of the view, ``root`` its masking
root sqrt(alpha^2 + (1 - alpha^2) cosine^2).

``Lobe`` is the specular BRDF in one direction, times its cosine: ``value`` * (F0 (1 - ``grazing``) + ``grazing``). ``slope`` is
the derivative of ``value`` by alpha, ``pdf`` the density of ``sample_visible_ggx``, per steradian.
"""

from ia_bench.common.native import native
from ia_bench.material.brdf import MIN_COSINE, MIRROR

BRDF = native(
    """
    const float min_cosine = ${MIN_COSINE}f;
    struct Seen {
        Vec normal, view, tangent, bitangent, local;
        float alpha, cosine, root;
    };
    struct Lobe {
        float value, slope, grazing, pdf;
        Lobe(float value, float slope, float grazing, float pdf) : value(value), slope(slope), grazing(grazing), pdf(pdf) {}
        Lobe(const Lobe& from) : value(from.value), slope(from.slope), grazing(from.grazing), pdf(from.pdf) {}
    };
    const auto seen_point = [most, unit, min_cosine](Vec normal, Vec view, float alpha) {
        const float sign = normal.z >= 0.0f ? 1.0f : -1.0f;
        const float a = -1.0f / (sign + normal.z), b = normal.x * normal.y * a;
        const Vec tangent(1.0f + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
        const Vec bitangent(b, sign + normal.y * normal.y * a, -normal.y);
        const float cosine = most(normal.dot(view), min_cosine);
        const Vec local = unit(Vec(alpha * tangent.dot(view), alpha * bitangent.dot(view), cosine));
        const float root = ::sqrtf(alpha * alpha + (1.0f - alpha * alpha) * cosine * cosine);
        return Seen{normal, view, tangent, bitangent, local, alpha, cosine, root};
    };
    const auto sample_visible_ggx = [turned, most, least, unit](Seen point, float u, float v) {
        const Vec around = turned(u), local = point.local;
        const float cos_cap = (1.0f - v) * (1.0f + local.z) - local.z;
        const float sin_cap = ::sqrtf(least(most(1.0f - cos_cap * cos_cap, 0.0f), 1.0f));
        const float x = point.alpha * (sin_cap * around.x + local.x), y = point.alpha * (sin_cap * around.y + local.y);
        const Vec micro = unit(Vec(x, y, most(cos_cap + local.z, 0.0f)));
        const Vec half = point.tangent * micro.x + point.bitangent * micro.y + point.normal * micro.z;
        return half * (2.0f * point.view.dot(half)) - point.view;
    };
    const auto lobe_towards = [most, least, unit, pi, min_cosine](Seen point, Vec incident, float cos_i) {
        const Vec half = unit(point.view + incident);
        const float cos_h = point.normal.dot(half), alpha2 = point.alpha * point.alpha;
        const Vec tangential = half - point.normal * cos_h;
        const float inverse = 1.0f / most(tangential.dot(tangential) + alpha2 * cos_h * cos_h, ${MIRROR}f);
        const float height = point.alpha * inverse;  // the distribution of normals is its square over pi
        const float normals = height * height / pi;
        cos_i = most(cos_i, min_cosine);
        const float cos_o = point.cosine, root_i = ::sqrtf(alpha2 + (1.0f - alpha2) * cos_i * cos_i);
        const float masking = 0.5f / (cos_o * root_i + cos_i * point.root);
        const float by_height = 2.0f * inverse * (1.0f - 2.0f * alpha2 * cos_h * cos_h * inverse);
        const float by_masking = cos_o * (1.0f - cos_i * cos_i) / root_i + cos_i * (1.0f - cos_o * cos_o) / point.root;
        const float slope = height * cos_i / pi * masking * (by_height - 2.0f * height * masking * point.alpha * by_masking);
        const float miss = 1.0f - least(most(point.view.dot(half), 0.0f), 1.0f), miss2 = miss * miss;
        const bool above = cos_h > 0.0f;
        return Lobe(above ? normals * masking * cos_i : 0.0f, above ? slope : 0.0f, above ? miss2 * miss2 * miss : 0.0f,
                    above ? 0.5f * normals / (cos_o + point.root) : 0.0f);
    };
""",
    MIN_COSINE=MIN_COSINE,
    MIRROR=MIRROR,
)
