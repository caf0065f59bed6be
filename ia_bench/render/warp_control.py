"""The kernels of a control variate of diffuse light; see :mod:`ia_bench.render.control`.

Sums over the cells of the sky are native code, sixteen cells at a time: of a loop in Warp's own language the compiler makes one
cell after another.
"""

import warp as wp

from ia_bench.light.warp_latlong import direction_to_texel

wp.set_module_options({"enable_backward": False, "fast_math": False})

_CELLS = """
    const unsigned char* is_free = free.data + (long long)row * cells;
    const float *x = axes.data, *y = x + cells, *z = y + cells;
"""
_WEIGHT = """
            const float cosine = normal[0] * x[k] + normal[1] * y[k] + normal[2] * z[k];
            const float weight = is_free[k] != 0 && cosine > least ? cosine : 0.0f;
"""
_SUM = (
    _CELLS
    + """
    const float *red = power.data, *green = red + cells, *blue = green + cells;
    float reds[16] = {}, greens[16] = {}, blues[16] = {};
    for (int first = 0; first < cells; first += 16)
        for (int lane = 0; lane < 16; ++lane) {
            const int k = first + lane;
"""
    + _WEIGHT
    + """
            reds[lane] += weight * red[k];
            greens[lane] += weight * green[k];
            blues[lane] += weight * blue[k];
        }
    wp::vec3 total(0.0f, 0.0f, 0.0f);
    for (int lane = 0; lane < 16; ++lane) total += wp::vec3(reds[lane], greens[lane], blues[lane]);
    return total;
"""
)
_SPREAD = (
    _CELLS
    + """
    float *red = of_power.data, *green = red + cells, *blue = green + cells;
    for (int k = 0; k < cells; ++k) {
"""
    + _WEIGHT
    + """
#if defined(__CUDA_ARCH__)
        if (weight > 0.0f) {
            atomicAdd(red + k, weight * given[0]);
            atomicAdd(green + k, weight * given[1]);
            atomicAdd(blue + k, weight * given[2]);
        }
#else
        red[k] += weight * given[0];
        green[k] += weight * given[1];
        blue[k] += weight * given[2];
#endif
    }
"""
)


@wp.func_native(_SUM)
def _sum_of_cells(
    free: wp.array(dtype=wp.uint8), axes: wp.array(dtype=float), least: float, power: wp.array(dtype=float), cells: int, row: int,
    normal: wp.vec3,
) -> wp.vec3: ...  # fmt: skip


@wp.func_native(_SPREAD)
def _spread_to_cells(
    free: wp.array(dtype=wp.uint8), axes: wp.array(dtype=float), least: float, cells: int, row: int, normal: wp.vec3,
    given: wp.vec3, of_power: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel
def known(
    first: int, rows: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3), free: wp.array(dtype=wp.uint8),
    axes: wp.array(dtype=float), least: float, cells: int, power: wp.array(dtype=float), found: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """The sum over a texel's free cells of cosine times power, for a point; nothing for a row of -1."""
    n = first + wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    if rows[n] >= 0:
        total = _sum_of_cells(free, axes, least, power, cells, rows[n], normals[n])
    found[n] = total


@wp.kernel
def known_adjoint(
    first: int, rows: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3), free: wp.array(dtype=wp.uint8),
    axes: wp.array(dtype=float), least: float, cells: int, given: wp.array(dtype=wp.vec3), of_power: wp.array(dtype=float),
):  # fmt: skip
    """Add to the gradient of the cells' power."""
    n = first + wp.tid()
    if rows[n] >= 0:
        _spread_to_cells(free, axes, least, cells, rows[n], normals[n], given[n], of_power)


@wp.kernel
def subtract(
    first: int, rows: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3), free: wp.array(dtype=wp.uint8),
    axes: wp.array(dtype=float), least: float, height: int, blocked: wp.array2d(dtype=wp.uint8),
    directions: wp.array2d(dtype=wp.vec3), texels: wp.array2d(dtype=int), terms: wp.array2d(dtype=wp.vec4),
):  # fmt: skip
    """Make V cos - c of each sample's cosine, in ``terms``.

    A texel of the light that is in no sight becomes -1 where the control has nothing either, and else -2 less its number: what the
    object itself shows there keeps its lobe.
    """
    n = first + wp.tid()
    row = rows[n]
    normal = normals[n]
    cells = 2 * height * height
    for k in range(texels.shape[1]):
        texel = texels[n, k]
        if texel >= 0:
            control = float(0.0)
            direction = directions[n, k]
            if row >= 0:
                cell = direction_to_texel(direction, height, 2 * height)
                if free[row * cells + cell] != wp.uint8(0):
                    cosine = wp.dot(normal, wp.vec3(axes[cell], axes[cells + cell], axes[2 * cells + cell]))
                    control = wp.where(cosine > least, cosine, 0.0)
            visible = wp.where(blocked[n, k] == wp.uint8(0), 1.0, 0.0)
            term = terms[n, k]
            terms[n, k] = wp.vec4(term[0] * (visible - control / wp.dot(normal, direction)), term[1], term[2], term[3])
            if visible == 0.0:
                texels[n, k] = wp.where(control > 0.0, -2 - texel, -1)
