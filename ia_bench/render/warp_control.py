"""What is left of samples beside a control variate, as a Warp kernel; see :mod:`ia_bench.render.control`."""

import warp as wp

from ia_bench.light.warp_latlong import direction_to_texel

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def subtract(
    first: int, rows: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3), seen: wp.array2d(dtype=wp.float16), height: int,
    blocked: wp.array2d(dtype=wp.uint8), directions: wp.array2d(dtype=wp.vec3), texels: wp.array2d(dtype=int),
    terms: wp.array2d(dtype=wp.vec4),
):  # fmt: skip
    """Make V cos - c of each sample's cosine, in ``terms``; ``seen`` has c, of ``height`` rows of cells.

    A texel of the light that is in no sight becomes -1 where the control has nothing either, and else -2 less its number.
    """
    n = first + wp.tid()
    row = rows[n]
    for k in range(texels.shape[1]):
        texel = texels[n, k]
        if texel >= 0:
            control = float(0.0)
            direction = directions[n, k]
            if row >= 0:
                control = float(seen[row, direction_to_texel(direction, height, 2 * height)])
            visible = wp.where(blocked[n, k] == wp.uint8(0), 1.0, 0.0)
            term = terms[n, k]
            terms[n, k] = wp.vec4(term[0] * (visible - control / wp.dot(normals[n], direction)), term[1], term[2], term[3])
            if visible == 0.0:
                texels[n, k] = wp.where(control > 0.0, -2 - texel, -1)
