"""Rays through a grid of signed distances as Warp kernels: what they gather of features, and the adjoint of that.

Written by hand in both directions: a ray is marched again in the adjoint, so nothing is stored of its samples.
All lengths are in cells of the grid, and the origin of its frame is its first vertex.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

CHANNELS = 8
vec8 = wp.types.vector(length=CHANNELS, dtype=wp.float32)

_CLEAR = wp.constant(0.004)  # transmittance below which a ray ends
_STEPS = wp.constant(1024)  # of a ray, at most
_CAUTION = wp.constant(0.8)  # of a distance that is skipped: away from the surface, values are no exact distances
_FAR = wp.constant(6.0)  # widths from the surface beyond which the logistic function is as good as constant


@wp.struct
class GridTaps:
    """The cell of a point and where in it the point is."""

    cell: wp.vec3i
    place: wp.vec3


@wp.func
def taps_at(point: wp.vec3, values: wp.array3d(dtype=float)):
    """The cell of a point, the nearest one for a point outside of the grid."""
    taps = GridTaps()
    for axis in range(3):
        count = values.shape[axis]
        along = wp.clamp(point[axis], 0.0, float(count - 1) - 1.0e-4)
        taps.cell[axis] = wp.min(int(along), count - 2)
        taps.place[axis] = along - float(taps.cell[axis])
    return taps


@wp.func
def value_at(values: wp.array3d(dtype=float), t: GridTaps):
    """Trilinear."""
    x = t.cell[0]
    y = t.cell[1]
    z = t.cell[2]
    a = wp.lerp(values[x, y, z], values[x, y, z + 1], t.place[2])
    b = wp.lerp(values[x, y + 1, z], values[x, y + 1, z + 1], t.place[2])
    c = wp.lerp(values[x + 1, y, z], values[x + 1, y, z + 1], t.place[2])
    d = wp.lerp(values[x + 1, y + 1, z], values[x + 1, y + 1, z + 1], t.place[2])
    return wp.lerp(wp.lerp(a, b, t.place[1]), wp.lerp(c, d, t.place[1]), t.place[0])


@wp.func
def weight_of(t: GridTaps, i: int, j: int, k: int):
    """What the corner (i, j, k) of the cell, of zeros and ones, has of the point."""
    x = wp.where(i == 1, t.place[0], 1.0 - t.place[0])
    y = wp.where(j == 1, t.place[1], 1.0 - t.place[1])
    return x * y * wp.where(k == 1, t.place[2], 1.0 - t.place[2])


@wp.func
def add_value(values: wp.array3d(dtype=float), t: GridTaps, amount: float):
    """The adjoint of :func:`value_at`."""
    for i in range(2):
        for j in range(2):
            for k in range(2):
                values[t.cell[0] + i, t.cell[1] + j, t.cell[2] + k] += amount * weight_of(t, i, j, k)


@wp.func
def features_at(features: wp.array3d(dtype=vec8), t: GridTaps):
    """Trilinear."""
    total = vec8()
    for i in range(2):
        for j in range(2):
            for k in range(2):
                total += weight_of(t, i, j, k) * features[t.cell[0] + i, t.cell[1] + j, t.cell[2] + k]
    return total


@wp.func
def add_features(features: wp.array3d(dtype=vec8), t: GridTaps, amount: vec8):
    """The adjoint of :func:`features_at`."""
    for i in range(2):
        for j in range(2):
            for k in range(2):
                features[t.cell[0] + i, t.cell[1] + j, t.cell[2] + k] += weight_of(t, i, j, k) * amount


@wp.func
def logistic(x: float):
    """1 / (1 + exp(-x))."""
    return 1.0 / (1.0 + wp.exp(-wp.clamp(x, -40.0, 40.0)))


@wp.kernel
def gather(
    first: int, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3), near: wp.array(dtype=float),
    far: wp.array(dtype=float), values: wp.array3d(dtype=float), features: wp.array3d(dtype=vec8), width: float, stride: float,
    gathered: wp.array(dtype=vec8), opacity: wp.array(dtype=float), depth: wp.array(dtype=float),
):  # fmt: skip
    """Features, opacity and distance that a ray gathers, each weighted by what stops it there."""
    n = first + wp.tid()
    total = vec8()
    distance = float(0.0)
    clear = float(1.0)
    t = float(near[n])
    before = value_at(values, taps_at(origins[n] + t * directions[n], values))
    cumulative = logistic(before / width)
    for _step in range(_STEPS):
        if t >= far[n] or clear < _CLEAR:
            break
        skip = _CAUTION * (before - _FAR * width)
        if skip > stride:
            t += skip
            before = value_at(values, taps_at(origins[n] + t * directions[n], values))
            cumulative = logistic(before / width)
            continue
        after = value_at(values, taps_at(origins[n] + (t + stride) * directions[n], values))
        next_cumulative = logistic(after / width)
        if next_cumulative < cumulative:
            weight = clear * (1.0 - next_cumulative / cumulative)
            middle = t + 0.5 * stride
            total += weight * features_at(features, taps_at(origins[n] + middle * directions[n], values))
            distance += weight * middle
            clear *= next_cumulative / cumulative
        t += stride
        before = after
        cumulative = next_cumulative
    gathered[n] = total
    opacity[n] = 1.0 - clear
    depth[n] = distance


@wp.kernel
def gather_adjoint(
    first: int, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3), near: wp.array(dtype=float),
    far: wp.array(dtype=float), values: wp.array3d(dtype=float), features: wp.array3d(dtype=vec8), width: float, stride: float,
    gathered: wp.array(dtype=vec8), opacity: wp.array(dtype=float), depth: wp.array(dtype=float),
    of_gathered: wp.array(dtype=vec8), of_opacity: wp.array(dtype=float), of_depth: wp.array(dtype=float),
    of_values: wp.array3d(dtype=float), of_features: wp.array3d(dtype=vec8),
):  # fmt: skip
    """What :func:`gather` passes back to values and features.

    With the weight w_i = T_i (1 - r_i), r_i = S(f_{i+1} / s) / S(f_i / s), T_i = r_0 ... r_{i-1}, and q_i what a unit of w_i is
    worth: dL / dr_i = (sum over j > i of w_j q_j) / r_i - T_i q_i, and S' = S (1 - S).
    """
    n = first + wp.tid()
    rest = wp.dot(of_gathered[n], gathered[n]) + of_opacity[n] * opacity[n] + of_depth[n] * depth[n]
    clear = float(1.0)
    t = float(near[n])
    place = taps_at(origins[n] + t * directions[n], values)
    before = value_at(values, place)
    cumulative = logistic(before / width)
    owed = float(0.0)  # to the value at the end of the last segment
    for _step in range(_STEPS):
        if t >= far[n] or clear < _CLEAR:
            break
        skip = _CAUTION * (before - _FAR * width)
        if skip > stride:
            if owed != 0.0:
                add_value(of_values, place, owed)
                owed = 0.0
            t += skip
            place = taps_at(origins[n] + t * directions[n], values)
            before = value_at(values, place)
            cumulative = logistic(before / width)
            continue
        end = taps_at(origins[n] + (t + stride) * directions[n], values)
        after = value_at(values, end)
        next_cumulative = logistic(after / width)
        owed_after = float(0.0)
        if next_cumulative < cumulative:
            ratio = next_cumulative / cumulative
            weight = clear * (1.0 - ratio)
            middle = t + 0.5 * stride
            inner = taps_at(origins[n] + middle * directions[n], values)
            worth = wp.dot(of_gathered[n], features_at(features, inner)) + of_opacity[n] + of_depth[n] * middle
            add_features(of_features, inner, weight * of_gathered[n])
            rest -= weight * worth
            of_log_ratio = rest - clear * ratio * worth
            owed -= of_log_ratio * (1.0 - cumulative) / width
            owed_after = of_log_ratio * (1.0 - next_cumulative) / width
            clear *= ratio
        if owed != 0.0:
            add_value(of_values, place, owed)
        owed = owed_after
        t += stride
        place = end
        before = after
        cumulative = next_cumulative
    if owed != 0.0:
        add_value(of_values, place, owed)
