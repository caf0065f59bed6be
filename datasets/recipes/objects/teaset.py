"""A tea set for tuning: painted teapot and cup, terracotta honey pot, and a folded cloth on a wooden tray.

Saturated pattern under gloss beside matt clay, wood and cloth, about 10600 triangles.
"""

from __future__ import annotations

import bpy
import numpy as np

from .forms import box, lathe, sheet, smooth_path, store_chart, tube_along_curve
from .paint import Paint, Socket

TEAPOT, CUP, HONEY = (-0.20, 0.10), (0.40, -0.14), (0.42, 0.22)
"""Where the vessels stand on the tray, (x, y)."""

TRAY = -0.45
"""Height of the tray's floor."""


def build() -> None:
    """Build the tea set in the empty scene, within the unit sphere."""
    clay, timber = terracotta(), wood()
    _tray(timber)
    _teapot(faience("teapot", TEAPOT, -0.07, 0.20, 6), cobalt(), timber)
    _cup(faience("cup", CUP, -0.265, 0.085, 5), faience("saucer", CUP, TRAY, 0.05, 9))
    _honey_pot(clay, timber)
    _cloth(checked())


# ---------------------------------------------------------------- paints
def faience(name: str, centre: tuple[float, float], middle: float, height: float, count: int) -> bpy.types.Material:
    """White glaze with `count` blossoms and leaves round the axis, between blue bands; an unglazed clay foot.

    The blossoms reach from `middle` by `height` up and down. Glaze is smooth, the paint over it half matt.
    """
    paint = Paint(name)
    p = paint.position()
    x, y, z = paint.split(p)
    turn = paint.formula("arctan2(y - b, x - a) * n", x=x, y=y, a=centre[0], b=centre[1], n=count / (2 * np.pi))
    u, between = (paint.formula("(fract(t + s) - 0.5) * 2", t=turn, s=shift) for shift in (0.0, 0.5))
    v = paint.formula("(z - m) / h", z=z, m=middle, h=height)
    reach = paint.formula("sqrt(u * u + v * v)", u=u, v=v)
    petals = paint.formula("r - 0.50 - 0.15 * cosine(arctan2(v, u) * 5)", r=reach, u=u, v=v)
    blossom = paint.smooth(petals, -0.03, 0.02, 1.0, 0.0)
    heart = paint.smooth(reach, 0.15, 0.20, 1.0, 0.0)
    leaf = paint.smooth(paint.formula("u * u * 10 + v * v", u=between, v=v), 0.55, 0.65, 1.0, 0.0)
    vein = paint.smooth(paint.formula("absolute(u)", u=between), 0.02, 0.04, 1.0, 0.0)
    bands = paint.smooth(paint.formula("absolute(absolute(v) - 1.18)", v=v), 0.13, 0.16, 1.0, 0.0)
    foot = paint.smooth(v, -1.68, -1.62, 1.0, 0.0)

    cloudy = paint.noise(p, 6.0)
    white = paint.mix(cloudy, (0.66, 0.60, 0.48), (0.82, 0.79, 0.70))
    red = paint.mix(paint.smooth(reach, 0.1, 0.6), (0.34, 0.03, 0.05), (0.70, 0.11, 0.05))
    green = paint.mix(vein, (0.05, 0.25, 0.09), (0.26, 0.46, 0.10))
    colour = paint.mix(blossom, paint.mix(leaf, white, green), red)
    colour = paint.mix(heart, colour, (0.78, 0.48, 0.06))
    colour = paint.mix(bands, colour, (0.04, 0.09, 0.40))
    painted = paint.math("MAXIMUM", blossom, leaf)
    rough = paint.blend(painted, paint.smooth(cloudy, 0.35, 0.65, 0.15, 0.24), 0.36)
    return paint.finish(paint.mix(foot, colour, (0.46, 0.20, 0.11)), paint.blend(foot, rough, 0.85))


def cobalt() -> bpy.types.Material:
    """Spout, handle and rim: blue glaze, paler where it runs thin."""
    paint = Paint("cobalt")
    thin = paint.smooth(paint.noise(paint.position(), 9.0), 0.42, 0.62)
    return paint.finish(paint.mix(thin, (0.03, 0.06, 0.30), (0.10, 0.22, 0.52)), paint.blend(thin, 0.16, 0.28))


def terracotta() -> bpy.types.Material:
    """Matt red clay with turning marks and chalky bloom."""
    paint = Paint("terracotta")
    p = paint.position()
    _, _, z = paint.split(p)
    marks = paint.formula("0.5 + 0.5 * sine(z * 190 + 3 * n)", z=z, n=paint.noise(p, 5.0))
    bloom = paint.smooth(paint.noise(p, 5.5), 0.50, 0.68)
    clay = paint.mix(marks, (0.40, 0.15, 0.07), (0.54, 0.23, 0.12))
    return paint.finish(paint.mix(bloom, clay, (0.66, 0.50, 0.40)), paint.blend(bloom, 0.80, 0.90))


def wood() -> bpy.types.Material:
    """Oiled walnut: grain along x, dark pores, a pale ring where something hot stood."""
    paint = Paint("walnut")
    p = paint.position()
    x, y, _ = paint.split(p)
    grain = paint.noise(paint.vector("MULTIPLY", p, (2.5, 22.0, 22.0)), 1.0)
    pores = paint.smooth(paint.noise(paint.vector("MULTIPLY", p, (9.0, 90.0, 90.0)), 1.0), 0.56, 0.66)
    colour = paint.mix(paint.smooth(grain, 0.3, 0.7), (0.17, 0.075, 0.035), (0.42, 0.22, 0.10))
    colour = paint.mix(paint.math("MULTIPLY", pores, 0.6), colour, (0.07, 0.035, 0.02))
    ring = paint.formula("absolute(sqrt((x - 0.10) * (x - 0.10) + (y + 0.24) * (y + 0.24)) - 0.11)", x=x, y=y)
    stain = paint.formula("s * (0.4 + n)", s=paint.smooth(ring, 0.006, 0.016, 0.7, 0.0), n=paint.noise(p, 14.0))
    return paint.finish(paint.mix(stain, colour, (0.60, 0.47, 0.34)), paint.formula("0.38 + 0.2 * g + 0.2 * s", g=grain, s=stain))


def checked() -> bpy.types.Material:
    """Linen with checks of indigo and madder that mix where they cross, and a visible weave."""
    paint = Paint("linen")
    u, v, _ = paint.split(paint.attribute("chart"))

    def stripes(along: Socket) -> Socket:
        return paint.smooth(paint.formula("absolute(fract(s * 9) - 0.5)", s=along), 0.26, 0.29)

    warp, weft = stripes(u), stripes(v)
    weave = paint.formula("0.5 + 0.25 * (sine(u * 420) + sine(v * 420))", u=u, v=v)
    ground = paint.mix(weave, (0.56, 0.51, 0.40), (0.76, 0.72, 0.60))
    colour = paint.mix(paint.math("MULTIPLY", warp, 0.8), ground, (0.07, 0.10, 0.28))
    colour = paint.mix(paint.math("MULTIPLY", weft, 0.6), colour, (0.48, 0.09, 0.07))
    return paint.finish(colour, paint.blend(weave, 0.90, 0.82))


# ---------------------------------------------------------------- parts
def _tray(timber: bpy.types.Material) -> None:
    """Board with a raised rim and two grips."""
    box("floor", (0.0, 0.0, TRAY - 0.02), (1.24, 0.84, 0.04), timber, bevel=0.008, segments=1)
    for side in (-1, 1):
        box("rim", (0.0, 0.41 * side, TRAY + 0.02), (1.26, 0.035, 0.12), timber, bevel=0.010)
        box("rim", (0.62 * side, 0.0, TRAY + 0.02), (0.035, 0.80, 0.12), timber, bevel=0.010)
        grip = [(0.62, -0.16, -0.40), (0.63, -0.14, -0.33), (0.64, -0.06, -0.29), (0.64, 0.06, -0.29), (0.63, 0.14, -0.33)]
        path = smooth_path([*grip, (0.62, 0.16, -0.40)], 17) * (side, 1, 1)
        tube_along_curve("grip", path, np.full(17, 0.022), timber, sides=8)


def _teapot(glaze: bpy.types.Material, blue: bpy.types.Material, timber: bpy.types.Material) -> None:
    """Round pot on a foot ring, with lid, spout and handle."""
    at = (*TEAPOT, 0.0)
    outline = [(0.20, TRAY), (0.21, -0.42), (0.20, -0.40), (0.27, -0.33), (0.34, -0.22), (0.375, -0.08), (0.36, 0.06)]
    outline += [(0.30, 0.17), (0.22, 0.225), (0.185, 0.235)]
    body = smooth_path([(r, 0.0, z) for r, z in outline], 26)
    lathe("pot", [(0.0, TRAY), *((r, z) for r, _, z in body), (0.0, 0.235)], glaze, 44, at, sharp_deg=60)
    rim = [(0.0, 0.23), (0.195, 0.23), (0.215, 0.24), (0.215, 0.258), (0.195, 0.268)]
    lathe("lid", [*rim, (0.16, 0.31), (0.10, 0.345), (0.04, 0.36), (0.0, 0.36)], blue, 36, at)
    knob = [(0.0, 0.35), (0.03, 0.355), (0.025, 0.375), (0.05, 0.40), (0.055, 0.43), (0.035, 0.455), (0.0, 0.462)]
    lathe("knob", knob, timber, 14, at, sharp_deg=80)
    spout = [(0.28, 0.0, -0.22), (0.42, 0.0, -0.17), (0.50, 0.0, -0.03), (0.54, 0.0, 0.12), (0.61, 0.0, 0.21)]
    radii = np.interp(np.linspace(0, 1, 18), (0.0, 0.3, 0.8, 0.93, 1.0), (0.105, 0.085, 0.046, 0.044, 0.054))
    tube_along_curve("spout", smooth_path(spout, 18) + at, radii, blue, sides=14)
    handle = [(-0.27, 0.0, 0.14), (-0.40, 0.0, 0.22), (-0.53, 0.0, 0.16), (-0.56, 0.0, 0.0), (-0.47, 0.0, -0.16)]
    path = smooth_path([*handle, (-0.31, 0.0, -0.23)], 22) + at
    tube_along_curve("handle", path, np.full(22, 0.034), blue, sides=10, flatness=1.3)


def _cup(glaze: bpy.types.Material, rim: bpy.types.Material) -> None:
    """Hollow cup with a handle on a saucer."""
    at = (*CUP, TRAY)
    lathe("saucer", [(0.0, 0.0), (0.11, 0.0), (0.12, 0.012), (0.20, 0.045), (0.205, 0.053), (0.195, 0.055), (0.12, 0.028),
                     (0.0, 0.024)], rim, 32, at)  # fmt: skip
    outside = [(0.0, 0.024), (0.07, 0.024), (0.072, 0.05), (0.11, 0.08), (0.14, 0.15), (0.148, 0.22), (0.158, 0.29)]
    inside = [(0.154, 0.297), (0.146, 0.29), (0.136, 0.22), (0.127, 0.15), (0.10, 0.095), (0.05, 0.07), (0.0, 0.066)]
    lathe("cup", [*outside, *inside], glaze, 32, at, sharp_deg=70)
    loop = [(0.135, 0.0, 0.24), (0.20, 0.0, 0.26), (0.235, 0.0, 0.20), (0.20, 0.0, 0.13), (0.12, 0.0, 0.11)]
    path = smooth_path(loop, 16) * (0.6, 0.0, 1.0) + np.outer(smooth_path(loop, 16)[:, 0], (0.2, -0.75, 0.0)) + at
    tube_along_curve("cup handle", path, np.full(16, 0.018), glaze, sides=8)


def _honey_pot(clay: bpy.types.Material, timber: bpy.types.Material) -> None:
    """Open clay jar, deep enough to shade itself, with a wooden spoon in it."""
    at = (*HONEY, TRAY)
    outside = [(0.0, 0.0), (0.09, 0.0), (0.10, 0.012), (0.135, 0.10), (0.14, 0.18), (0.115, 0.25), (0.125, 0.275)]
    inside = [(0.122, 0.285), (0.108, 0.28), (0.097, 0.25), (0.118, 0.18), (0.112, 0.10), (0.08, 0.03), (0.0, 0.025)]
    lathe("jar", [*outside, *inside], clay, 28, at, sharp_deg=60)
    stick = np.linspace((0.03, 0.02, 0.03), (-0.17, -0.03, 0.47), 6) + at
    tube_along_curve("spoon", stick, np.array([0.022, 0.012, 0.012, 0.012, 0.014, 0.020]), timber, sides=8)


def _cloth(linen: bpy.types.Material) -> None:
    """Cloth folded once, lying on the tray and hanging over its rim in two layers with waves."""
    lower = [(-0.455, -0.64), (-0.452, -0.50), (-0.45, -0.37), (-0.41, -0.345), (-0.37, -0.40), (-0.30, -0.432)]
    turn = [(-0.16, -0.432), (-0.135, -0.415), (-0.16, -0.398)]
    upper = [(-0.30, -0.398), (-0.36, -0.37), (-0.41, -0.310), (-0.475, -0.335), (-0.485, -0.45), (-0.488, -0.56)]
    line = smooth_path([(0.0, y, z) for y, z in (*lower, *turn, *upper)], 44)
    rows, columns = len(line), 20
    across = np.linspace(-0.06, -0.50, columns)
    points = np.repeat(line[:, None], columns, axis=1)
    points[..., 0] = across + 0.03 * (line[:, 2:] + 0.4)
    hanging = np.clip((-0.38 - line[:, 2]) / 0.2, 0.0, 1.0) * (line[:, 1] < -0.44)
    wave = 0.5 + 0.5 * np.sin(across * 34.0 + 0.8)
    points[..., 1] -= np.outer(hanging, 0.055 * wave)
    item = sheet("cloth", points, linen, thickness=0.012, sharp_deg=70)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    chart = np.tile(np.stack([np.tile(across, rows), np.repeat(length, columns), np.zeros(rows * columns)], axis=1), (2, 1))
    corner = np.empty(len(item.data.loops), np.int32)
    item.data.loops.foreach_get("vertex_index", corner)
    store_chart(item, chart[corner])
