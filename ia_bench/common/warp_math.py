"""What several Warp kernels compute."""

import warp as wp

_PI = wp.constant(wp.float32(wp.pi))


@wp.func
def unit(a: wp.vec3) -> wp.vec3:
    """A unit vector; a zero vector stays zero."""
    return a * (1.0 / wp.sqrt(wp.max(wp.dot(a, a), 1.0e-20)))


@wp.func
def arc_cosine(x: float) -> float:
    """In [0, pi], for x in [-1, 1], to 1e-7 (Abramowitz and Stegun, 4.4.46)."""
    a = wp.abs(x)
    p = -0.0012624911
    p = p * a + 0.0066700901
    p = p * a - 0.0170881256
    p = p * a + 0.0308918810
    p = p * a - 0.0501743046
    p = p * a + 0.0889789874
    p = p * a - 0.2145988016
    p = p * a + 0.5 * _PI  # 2e-8 more than the source has, so that the equator is where it is
    angle = wp.sqrt(1.0 - a) * p
    return wp.where(x >= 0.0, angle, _PI - angle)


@wp.func
def arc_tangent(y: float, x: float) -> float:
    """The angle of (x, y) in [-pi, pi], to 1e-7 (Abramowitz and Stegun, 4.4.49, for the smaller over the larger)."""
    far = wp.max(wp.abs(x), wp.abs(y))
    t = wp.min(wp.abs(x), wp.abs(y)) / wp.max(far, 1.0e-30)
    t2 = t * t
    p = 0.0028662257
    p = p * t2 - 0.0161657367
    p = p * t2 + 0.0429096138
    p = p * t2 - 0.0752896400
    p = p * t2 + 0.1065626393
    p = p * t2 - 0.1420889944
    p = p * t2 + 0.1999355085
    p = p * t2 - 0.3333314528
    angle = t + t * t2 * p
    angle = wp.where(wp.abs(y) > wp.abs(x), 0.5 * _PI - angle, angle)
    angle = wp.where(x < 0.0, _PI - angle, angle)
    return wp.where(1.0 / y < 0.0, -angle, angle)  # minus zero is below


@wp.func
def turned(turns: float) -> wp.vec2:
    """Cosine and sine of 2 pi ``turns``, for turns in [-2, 2], to 1e-7: a polynomial within an eighth of a turn."""
    quarter = wp.floor(4.0 * turns + 0.5)
    x = (4.0 * turns - quarter) * (0.5 * _PI)
    x2 = x * x
    sine = x * (1.0 - x2 * (1.0 / 6.0 - x2 * (1.0 / 120.0 - x2 * (1.0 / 5040.0 - x2 * (1.0 / 362880.0)))))
    cosine = 1.0 - x2 * (0.5 - x2 * (1.0 / 24.0 - x2 * (1.0 / 720.0 - x2 * (1.0 / 40320.0))))
    which = int(quarter)
    odd = (which & 1) == 1
    along = wp.where(odd, -sine, cosine)
    across = wp.where(odd, cosine, sine)
    sign = wp.where((which & 2) == 2, -1.0, 1.0)
    return wp.vec2(sign * along, sign * across)
