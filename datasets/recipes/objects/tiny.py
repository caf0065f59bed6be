"""A painted wooden mushroom house, for tests: glossy cap, hollow cup, lettered sign, about 3000 triangles."""

from __future__ import annotations

import bpy
import numpy as np

from .forms import box, lathe, plate, tube_along_curve
from .paint import Paint, Socket

CEILING, SLOPE = 0.36, 0.42
"""The underside of the cap is a cone: height CEILING - SLOPE * radius."""


def build() -> None:
    """Build the house in the empty scene, within the unit sphere."""
    wood, trim = grained("wood", (0.34, 0.18, 0.075)), grained("trim", (0.10, 0.22, 0.34))
    _ground(meadow())
    _house(plaster(), lacquer(), wood, trim)
    lathe("cup", _hollow(CUP, 0.022), glaze(), steps=20, origin=(0.50, -0.28, -0.56), sharp_deg=70)
    _sign(lettered(), wood)


# ---------------------------------------------------------------- paints
def radius(paint: Paint) -> tuple[Socket, Socket]:
    """Distance from the z axis, and z."""
    x, y, z = paint.split(paint.position())
    return paint.formula("sqrt(x * x + y * y)", x=x, y=y), z


def grained(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    """Painted wood: grain along z, lighter and rougher where it is worn."""
    paint = Paint(name)
    p = paint.position()
    grain = paint.noise(paint.vector("MULTIPLY", p, (30.0, 30.0, 3.0)), 1.0)
    worn = paint.smooth(paint.noise(p, 7.0), 0.52, 0.66)
    dark = tuple(0.5 * c for c in colour)
    colours = paint.mix(worn, paint.mix(grain, dark, colour), (0.52, 0.40, 0.26))
    return paint.finish(colours, paint.formula("0.40 + 0.15 * g + 0.30 * w", g=grain, w=worn))


def lacquer() -> bpy.types.Material:
    """Cap: glossy red lacquer with cream dots that are matt; below, dull gills."""
    paint = Paint("cap")
    p = paint.position()
    x, y, _ = paint.split(p)
    r, z = radius(paint)
    cell = paint.voronoi(p, 3.6)
    dots = paint.smooth(cell["Distance"], 0.085, 0.100, 1.0, 0.0)
    cloudy = paint.noise(p, 8.0)
    top = paint.mix(dots, paint.mix(cloudy, (0.40, 0.03, 0.03), (0.66, 0.10, 0.05)), (0.78, 0.70, 0.52))
    gloss = paint.blend(dots, paint.smooth(cloudy, 0.40, 0.62, 0.17, 0.36), 0.55)
    spokes = paint.formula("0.5 + 0.5 * sine(arctan2(y, x) * 36)", x=x, y=y)
    gills = paint.mix(spokes, (0.26, 0.16, 0.10), (0.58, 0.45, 0.30))
    above = paint.smooth(paint.formula(f"z - {CEILING} + {SLOPE} * r", z=z, r=r), 0.012, 0.022)
    return paint.finish(paint.mix(above, gills, top), paint.blend(above, 0.88, gloss))


def plaster() -> bpy.types.Material:
    """Stem: cream plaster with flaked patches that show brick."""
    paint = Paint("plaster")
    p = paint.position()
    x, y, z = paint.split(p)
    course = paint.formula("floor(z * 16)", z=z)
    along = paint.formula("arctan2(y, x) * 3.2 + 0.5 * course", x=x, y=y, course=course)
    joint = paint.formula("maximum(absolute(fract(a) - 0.5) - 0.42, absolute(fract(z * 16) - 0.5) - 0.38)", a=along, z=z)
    brick = paint.mix(paint.random(paint.join(paint.math("FLOOR", along), course, 0.5)), (0.30, 0.10, 0.06), (0.50, 0.22, 0.12))
    wall = paint.mix(paint.smooth(joint, 0.0, 0.02), brick, (0.50, 0.47, 0.42))
    flaked = paint.smooth(paint.noise(p, 3.6), 0.53, 0.56)
    cream = paint.mix(paint.noise(p, 22.0), (0.58, 0.50, 0.36), (0.80, 0.73, 0.58))
    return paint.finish(paint.mix(flaked, cream, wall), paint.blend(flaked, 0.62, 0.85))


def meadow() -> bpy.types.Material:
    """Ground: grass with daisies, a path of flat stones, a bare wooden underside."""
    paint = Paint("meadow")
    p = paint.position()
    x, y, z = paint.split(p)
    blades = paint.noise(p, 26.0)
    grass = paint.mix(blades, (0.05, 0.13, 0.03), (0.22, 0.38, 0.08))
    daisies = paint.smooth(paint.voronoi(p, 6.5)["Distance"], 0.026, 0.034, 1.0, 0.0)
    grass = paint.mix(daisies, grass, (0.82, 0.76, 0.30))
    stones = paint.voronoi(p, 7.0, flat=True)
    slab = paint.smooth(stones["Distance"], 0.050, 0.066, 1.0, 0.0)
    on_path = paint.formula("less_than(absolute(y + 0.12 * sine(x * 6)), 0.13) * greater_than(x, 0.2)", x=x, y=y)
    path = paint.math("MULTIPLY", slab, on_path)
    tone = paint.split(stones["Color"])[0]
    colour = paint.mix(path, grass, paint.mix(tone, (0.26, 0.25, 0.26), (0.50, 0.47, 0.43)))
    rough = paint.blend(path, 0.82, paint.formula("0.28 + 0.25 * t", t=tone))
    rings = paint.formula("0.5 + 0.5 * sine(70 * sqrt(x * x + y * y + 0.01))", x=x, y=y)
    top = paint.smooth(z, -0.625, -0.61)
    return paint.finish(
        paint.mix(top, paint.mix(rings, (0.30, 0.19, 0.10), (0.44, 0.30, 0.17)), colour), paint.blend(top, 0.6, rough)
    )


def glaze() -> bpy.types.Material:
    """Cup: glossy cobalt glaze with white bands, pooling darker and smoother toward the foot."""
    paint = Paint("glaze")
    _, z = radius(paint)
    bands = paint.smooth(paint.formula("absolute(fract(z * 9 + 0.32) - 0.5)", z=z), 0.36, 0.40)
    pooled = paint.smooth(z, -0.55, -0.34, 1.0, 0.0)
    cobalt = paint.mix(pooled, (0.09, 0.20, 0.55), (0.03, 0.06, 0.24))
    return paint.finish(paint.mix(bands, cobalt, (0.80, 0.80, 0.76)), paint.blend(pooled, 0.32, 0.17))


def lettered() -> bpy.types.Material:
    """Sign: satin white board with two rows of block letters, each a random 3 x 5 pattern."""
    paint = Paint("sign")
    _, y, z = paint.split(paint.position())
    u, v = paint.formula("(y - 0.18) / 0.32 * 20", y=y), paint.formula("(z + 0.30) / 0.21 * 15", z=z)
    column, row = paint.formula("floor(u) - floor(u / 4) * 4", u=u), paint.formula("floor(v) - floor(v / 7) * 7", v=v)
    stroke = paint.random(paint.join(paint.math("FLOOR", u), paint.math("FLOOR", v), 7.5))
    ink = paint.formula(
        "greater_than(s, 0.38) * greater_than(c, 0.5) * greater_than(r, 1.5) * less_than(v, 14) * greater_than(v, 0)",
        s=stroke, c=column, r=row, v=v,
    )  # fmt: skip
    dirt = paint.noise(paint.position(), 12.0)
    board = paint.mix(dirt, (0.62, 0.60, 0.52), (0.82, 0.80, 0.74))
    return paint.finish(paint.mix(ink, board, (0.03, 0.03, 0.05)), paint.blend(ink, 0.42, 0.22))


# ---------------------------------------------------------------- parts
CUP = ((0.0, 0.0), (0.10, 0.0), (0.13, 0.02), (0.155, 0.09), (0.15, 0.17), (0.165, 0.225))


def _hollow(outside: tuple[tuple[float, float], ...], wall: float) -> list[tuple[float, float]]:
    """Profile of a vessel: the outside from the foot to the lip, then back down inside."""
    lip_radius, lip = outside[-1]
    inside = [(max(r - wall, 0.0), h + wall) for r, h in reversed(outside[1:-1])]
    return [*outside, (lip_radius - 0.4 * wall, lip + 0.4 * wall), (lip_radius - wall, lip), *inside, (0.0, wall)]


def _ground(material: bpy.types.Material) -> None:
    """Round slab with a bevelled rim and a low mound under the house."""
    profile = [(0.0, -0.68), (0.68, -0.68), (0.715, -0.665), (0.73, -0.635), (0.715, -0.605), (0.69, -0.59)]
    lathe("ground", [*profile, (0.55, -0.572), (0.40, -0.545), (0.20, -0.53), (0.0, -0.53)], material, steps=36)


def _house(wall: bpy.types.Material, roof: bpy.types.Material, wood: bpy.types.Material, trim: bpy.types.Material) -> None:
    """Stem, cap with a hollow underside, door in a deep frame, two round windows, chimney."""
    foot = [(0.0, -0.56), (0.37, -0.56), (0.365, -0.45), (0.33, -0.30)]
    lathe("stem", [*foot, (0.29, -0.10), (0.265, 0.10), (0.26, 0.29), (0.0, 0.31)], wall, steps=28)
    angle = np.radians(np.linspace(4.0, 90.0, 10))
    dome = [(0.70 * np.cos(a), 0.12 + 0.74 * np.sin(a) ** 1.1) for a in angle[:-1]]
    under = [(r, CEILING - SLOPE * r) for r in (0.0, 0.2, 0.36, 0.52, 0.66)]
    lathe("cap", [*under, (0.692, 0.095), *dome, (0.0, 0.86)], roof, steps=36, sharp_deg=60)
    turn = np.linspace(0.0, np.pi, 9)
    arch = [(0.36, 0.13 * np.cos(t), -0.31 + 0.13 * np.sin(t)) for t in turn]
    frame = np.array([(0.36, 0.13, -0.55), (0.36, 0.13, -0.43), *arch, (0.36, -0.13, -0.43), (0.36, -0.13, -0.55)])
    tube_along_curve("door frame", frame, np.full(len(frame), 0.035), wood, sides=7)
    leaf = np.array([(0.345, 0.12, -0.55), *[(0.345, y * 0.92, z) for _, y, z in arch], (0.345, -0.12, -0.55)])
    plate("door", leaf, (0.03, 0.0, 0.0), trim)
    knob = [(0.0, 0.0), (0.014, 0.0), (0.022, 0.02), (0.012, 0.035), (0.0, 0.038)]
    lathe("knob", knob, wood, 8, (0.358, -0.07, -0.40), (1, 0, 0))
    ring = [(0.0, -0.03), (0.10, -0.03), (0.105, 0.02), (0.085, 0.03), (0.07, 0.005), (0.0, 0.002)]
    for azimuth in (1.9, -2.1):
        out = np.array((np.cos(azimuth), np.sin(azimuth), 0.0))
        lathe("window", ring, trim, 14, 0.295 * out + (0.0, 0.0, -0.12), out)
    box("chimney", (-0.28, 0.22, 0.69), (0.15, 0.15, 0.30), wall, bevel=0.012, segments=1)
    box("chimney top", (-0.28, 0.22, 0.82), (0.19, 0.19, 0.045), wood, bevel=0.012, segments=1)


def _sign(board: bpy.types.Material, wood: bpy.types.Material) -> None:
    """Lettered board on a post."""
    box("board", (0.60, 0.34, -0.20), (0.03, 0.36, 0.25), board, bevel=0.008, segments=1)
    box("post", (0.575, 0.34, -0.36), (0.045, 0.05, 0.50), wood, bevel=0.008, segments=1)
