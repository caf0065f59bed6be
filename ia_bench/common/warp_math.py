"""What several Warp kernels compute."""

import warp as wp

_PI = wp.constant(wp.float32(wp.pi))


@wp.func
def unit(a: wp.vec3) -> wp.vec3:
    """A unit vector; a zero vector stays zero."""
    return a * (1.0 / wp.sqrt(wp.max(wp.dot(a, a), 1.0e-20)))


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
