"""The BRDF of :mod:`ia_bench.material.brdf` as functions of Warp kernels; tests compare the two."""

import warp as wp

from ia_bench.common.warp_math import turned, unit
from ia_bench.material.brdf import MIN_COSINE, MIRROR

_MIN_COSINE = wp.constant(wp.float32(MIN_COSINE))
_MIRROR = wp.constant(wp.float32(MIRROR))
_PI = wp.constant(wp.float32(wp.pi))


@wp.struct
class Seen:
    """A surface point as a camera sees it: what all of its samples share.

    ``local`` is the view in the frame (tangent, bitangent, normal), stretched by ``alpha`` and unit again; ``cosine`` that of the
    view; ``root`` its masking root sqrt(alpha^2 + (1 - alpha^2) cosine^2).
    """

    normal: wp.vec3
    view: wp.vec3
    tangent: wp.vec3
    bitangent: wp.vec3
    local: wp.vec3
    alpha: float
    cosine: float
    root: float


@wp.func
def seen_point(normal: wp.vec3, view: wp.vec3, alpha: float) -> Seen:
    """The point that has this normal and is seen along ``view``, with the tangents of Duff et al. 2017."""
    point = Seen()
    sign = wp.where(normal[2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    point.normal = normal
    point.view = view
    point.tangent = wp.vec3(1.0 + sign * normal[0] * normal[0] * a, sign * b, -sign * normal[0])
    point.bitangent = wp.vec3(b, sign + normal[1] * normal[1] * a, -normal[1])
    point.alpha = alpha
    point.cosine = wp.max(wp.dot(normal, view), _MIN_COSINE)
    point.local = unit(wp.vec3(alpha * wp.dot(point.tangent, view), alpha * wp.dot(point.bitangent, view), point.cosine))
    point.root = wp.sqrt(alpha * alpha + (1.0 - alpha * alpha) * point.cosine * point.cosine)
    return point


@wp.func
def sample_visible_ggx(point: Seen, u: float, v: float) -> wp.vec3:
    """An incident direction from the visible normals; see :func:`ia_bench.material.brdf.sample_visible_ggx`."""
    local = point.local
    around = turned(u)
    cos_cap = (1.0 - v) * (1.0 + local[2]) - local[2]
    sin_cap = wp.sqrt(wp.clamp(1.0 - cos_cap * cos_cap, 0.0, 1.0))
    x = point.alpha * (sin_cap * around[0] + local[0])
    y = point.alpha * (sin_cap * around[1] + local[1])
    micro = unit(wp.vec3(x, y, wp.max(cos_cap + local[2], 0.0)))
    half = micro[0] * point.tangent + micro[1] * point.bitangent + micro[2] * point.normal
    return 2.0 * wp.dot(point.view, half) * half - point.view


@wp.struct
class Lobe:
    """The specular BRDF in one direction, times its cosine: ``value`` * (F0 (1 - ``grazing``) + ``grazing``).

    ``slope`` is the derivative of ``value`` by alpha; ``pdf`` the density of :func:`sample_visible_ggx`, per steradian.
    """

    value: float
    slope: float
    grazing: float
    pdf: float


@wp.func
def lobe_towards(point: Seen, incident: wp.vec3, cos_i: float) -> Lobe:
    """For a direction at a cosine above 0. The formulas are those of :mod:`ia_bench.material.brdf`."""
    lobe = Lobe()
    half = unit(point.view + incident)
    cos_h = wp.dot(point.normal, half)
    if cos_h <= 0.0:
        return lobe
    alpha2 = point.alpha * point.alpha
    tangential = half - cos_h * point.normal
    inverse = 1.0 / wp.max(wp.dot(tangential, tangential) + alpha2 * cos_h * cos_h, _MIRROR)
    height = point.alpha * inverse  # the distribution of normals is its square over pi
    normals = height * height / _PI
    cos_i = wp.max(cos_i, _MIN_COSINE)
    cos_o = point.cosine
    root_i = wp.sqrt(alpha2 + (1.0 - alpha2) * cos_i * cos_i)
    masking = 0.5 / (cos_o * root_i + cos_i * point.root)
    by_height = 2.0 * inverse * (1.0 - 2.0 * alpha2 * cos_h * cos_h * inverse)
    by_masking = cos_o * (1.0 - cos_i * cos_i) / root_i + cos_i * (1.0 - cos_o * cos_o) / point.root
    lobe.value = normals * masking * cos_i
    lobe.slope = height * cos_i / _PI * masking * (by_height - 2.0 * height * masking * point.alpha * by_masking)
    miss = 1.0 - wp.clamp(wp.dot(point.view, half), 0.0, 1.0)
    miss2 = miss * miss
    lobe.grazing = miss2 * miss2 * miss
    lobe.pdf = 0.5 * normals / (cos_o + point.root)
    return lobe
