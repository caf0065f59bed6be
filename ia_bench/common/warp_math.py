"""What several Warp kernels compute."""

import warp as wp


@wp.func
def unit(a: wp.vec3) -> wp.vec3:
    """A unit vector; a zero vector stays zero."""
    return a * (1.0 / wp.sqrt(wp.max(wp.dot(a, a), 1.0e-20)))
