"""A painted wooden owl on a stone, for tuning: carved feathers, deep eye sockets, folded wings, about 11000 triangles.

Round forms whose paint varies slowly under a fine pattern, with hollows that shade themselves. It faces -y.
"""

from __future__ import annotations

import bpy
import numpy as np

from .forms import grid_surface, lathe, plate, smooth_path, tube_along_curve
from .paint import Paint, Socket

EYE = (0.165, -0.250, 0.50)
"""Centre of its left eye; the right one is at -x."""

AROUND, ROWS = 18, 11
"""Feathers round the body, and rows of them from foot to crown."""


def build() -> None:
    """Build the owl in the empty scene, within the unit sphere."""
    horn = lacquer("horn", (0.12, 0.08, 0.06), (0.05, 0.035, 0.03), 0.22)
    skin = lacquer("feet", (0.70, 0.42, 0.08), (0.50, 0.24, 0.05), 0.34)
    quills = wing_paint()
    _stone(stone())
    _body(plumage())
    _face(eye_paint(), horn)
    _wings_and_tail(quills)
    _feet(skin, horn)


# ---------------------------------------------------------------- paints
def scallops(paint: Paint, u: Socket, v: Socket) -> tuple[Socket, Socket, Socket, Socket]:
    """Carved feathers of the chart (u, v): across [-0.5, 0.5], height over the tip's edge, row, a hash of the feather."""
    row = paint.formula(f"floor(v * {ROWS})", v=v)
    along = paint.formula(f"u * {AROUND} + 0.5 * row", u=u, row=row)
    across = paint.formula("fract(a) - 0.5", a=along)
    above = paint.formula(f"fract(v * {ROWS}) - 1.6 * a * a", v=v, a=across)
    column = paint.formula(f"floored_modulo(floor(a), {AROUND})", a=along)
    return across, above, row, paint.random(paint.join(column, row, 0.5))


def plumage() -> bpy.types.Material:
    """Body: teal back, cream to ochre breast, every feather with a pale rim and a dark shaft; worn to bare wood."""
    paint = Paint("plumage")
    p = paint.position()
    x, y, z = paint.split(p)
    u, v, front = paint.split(paint.attribute("chart"))
    across, above, _, chance = scallops(paint, u, v)
    cloudy = paint.noise(p, 3.0)
    back = paint.mix(paint.smooth(z, -0.5, 0.7), (0.04, 0.16, 0.22), (0.12, 0.30, 0.26))
    back = paint.mix(chance, back, (0.16, 0.16, 0.30))
    breast = paint.mix(paint.smooth(z, -0.5, 0.2), (0.50, 0.22, 0.06), (0.64, 0.50, 0.29))
    breast = paint.mix(paint.math("MULTIPLY", cloudy, chance), breast, (0.46, 0.14, 0.07))
    feather = paint.mix(paint.smooth(front, 0.35, 0.75), back, breast)
    rim = paint.smooth(above, 0.10, 0.22, 1.0, 0.0)
    shaft = paint.formula("less_than(absolute(a), 0.05) * greater_than(b, 0.2)", a=across, b=above)
    feather = paint.mix(paint.math("MULTIPLY", rim, 0.8), feather, (0.70, 0.60, 0.42))
    feather = paint.mix(shaft, feather, (0.12, 0.07, 0.05))
    feather = paint.mix(paint.smooth(above, -0.03, 0.02, 1.0, 0.0), feather, (0.09, 0.055, 0.04))

    far = paint.formula("sqrt((absolute(x) - e) * (absolute(x) - e) + (z - h) * (z - h))", x=x, z=z, e=EYE[0], h=EYE[2])
    ray = paint.formula("0.5 + 0.5 * sine(arctan2(z - h, absolute(x) - e) * 24)", x=x, z=z, e=EYE[0], h=EYE[2])
    disc = paint.mix(paint.math("MULTIPLY", ray, 0.6), (0.72, 0.65, 0.50), (0.40, 0.20, 0.09))
    disc = paint.mix(paint.smooth(far, 0.150, 0.165), disc, (0.10, 0.05, 0.04))
    facing = paint.smooth(y, -0.12, -0.08, 1.0, 0.0)
    face = paint.math("MULTIPLY", paint.smooth(far, 0.185, 0.195, 1.0, 0.0), facing)
    worn = paint.smooth(paint.noise(p, 5.0), 0.62, 0.68)
    colour = paint.mix(worn, paint.mix(face, feather, disc), (0.46, 0.32, 0.19))
    return paint.finish(colour, paint.blend(worn, paint.formula("0.34 + 0.25 * c", c=cloudy), 0.78))


def wing_paint() -> bpy.types.Material:
    """Wings and tail: rust with pale wavy bars that end in turquoise, darker toward the tip."""
    paint = Paint("quills")
    p = paint.position()
    x, y, z = paint.split(p)
    quill = paint.formula("y * 24 + z * 5", y=y, z=z)
    lines = paint.smooth(paint.formula("absolute(fract(q) - 0.5)", q=quill), 0.42, 0.47)
    bar = paint.formula("absolute(fract(z * 9 + 0.25 * sine(q * 6.2832)) - 0.5)", z=z, q=quill)
    bars = paint.smooth(bar, 0.33, 0.38)
    rust = paint.mix(paint.smooth(z, -0.55, 0.25), (0.20, 0.055, 0.03), (0.56, 0.19, 0.06))
    pale = paint.mix(paint.smooth(z, -0.40, -0.15), (0.14, 0.46, 0.44), (0.76, 0.62, 0.38))
    colour = paint.mix(lines, paint.mix(bars, rust, pale), (0.07, 0.04, 0.035))
    return paint.finish(colour, paint.formula("0.30 + 0.22 * b + 0.2 * l", b=bars, l=lines))


def eye_paint() -> bpy.types.Material:
    """Polished eyes: black pupil, amber iris with a darker rim."""
    paint = Paint("eye")
    x, _, z = paint.split(paint.position())
    far = paint.formula("sqrt((absolute(x) - e) * (absolute(x) - e) + (z - h) * (z - h))", x=x, z=z, e=EYE[0], h=EYE[2])
    iris = paint.mix(paint.smooth(far, 0.045, 0.080), (0.80, 0.50, 0.05), (0.50, 0.15, 0.03))
    return paint.finish(paint.mix(paint.smooth(far, 0.042, 0.048), (0.03, 0.03, 0.035), iris), 0.16)


def lacquer(name: str, light: tuple[float, ...], dark: tuple[float, ...], roughness: float) -> bpy.types.Material:
    """Lacquer that varies between two colours."""
    paint = Paint(name)
    patches = paint.noise(paint.position(), 12.0)
    return paint.finish(paint.mix(patches, light, dark), roughness)


def stone() -> bpy.types.Material:
    """Stone: speckled grey, matt, with rust stains and moss where it faces up."""
    paint = Paint("stone")
    p = paint.position()
    _, _, z = paint.split(p)
    grey = paint.mix(paint.noise(p, 4.0), (0.22, 0.21, 0.21), (0.52, 0.49, 0.45))
    grey = paint.mix(paint.smooth(paint.noise(p, 45.0, 1.0), 0.60, 0.68), grey, (0.10, 0.09, 0.09))
    grey = paint.mix(paint.smooth(paint.noise(p, 2.6), 0.52, 0.66, 0.0, 0.7), grey, (0.42, 0.20, 0.09))
    lush = paint.formula("z + 0.8 + 0.7 * (n - 0.5)", z=z, n=paint.noise(p, 7.0))
    moss = paint.smooth(lush, 0.14, 0.20)
    tufts = paint.mix(paint.noise(p, 40.0), (0.06, 0.11, 0.03), (0.26, 0.32, 0.08))
    return paint.finish(paint.mix(moss, grey, tufts), paint.blend(moss, 0.72, 0.90))


# ---------------------------------------------------------------- parts
def _body(paint: bpy.types.Material) -> None:
    """Body and head in one, carved with the feathers that `plumage` paints, and two sockets for the eyes."""
    section = [(0.16, 0.16, -0.60), (0.29, 0.28, -0.53), (0.40, 0.38, -0.34), (0.44, 0.41, -0.08), (0.41, 0.38, 0.14)]
    section += [(0.355, 0.335, 0.27), (0.37, 0.34, 0.38), (0.39, 0.345, 0.52), (0.34, 0.30, 0.68), (0.22, 0.20, 0.78)]
    core = smooth_path([*section, (0.05, 0.05, 0.82)], 4 * ROWS + 1)
    columns = 4 * AROUND
    angle = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    points = np.stack([np.outer(core[:, 0], np.cos(angle)), np.outer(core[:, 1], np.sin(angle)),
                       np.repeat(core[:, 2:], columns, axis=1)], axis=-1)  # fmt: skip
    v, u = np.meshgrid(np.linspace(0.0, 1.0, len(core)), np.linspace(0.0, 1.0, columns + 1), indexing="ij")
    front = -np.sin(2.0 * np.pi * u)
    row = np.floor(v * ROWS + 1e-9)
    across = (u * AROUND + 0.5 * row) % 1.0 - 0.5
    above = v * ROWS - row
    far = np.hypot(np.abs(points[..., 0]) - EYE[0], points[..., 2] - EYE[2])
    face = (points[..., 1] < 0.0) * np.exp(-((far / 0.17) ** 6))
    relief = 0.030 * (1.0 - above) * (1.0 - 1.6 * across**2) * np.minimum(1.0, 8.0 * v * (1.0 - v))
    outward = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    points += ((1.0 - face) * relief[:, :-1])[..., None] * outward
    points[..., 1] += 0.085 * face * np.clip(1.0 - (far / 0.19) ** 2, 0.0, 1.0)  # the sockets
    grid_surface("body", points, paint, np.stack([u, v, front], axis=-1))


def _face(eyes: bpy.types.Material, horn: bpy.types.Material) -> None:
    """Eyes in their sockets, a hooked beak, two ear tufts."""
    polar = np.linspace(0.0, np.pi, 11)
    ball = [(0.084 * np.sin(a), -0.084 * np.cos(a)) for a in polar]
    for side in (-1, 1):
        centre = np.multiply(EYE, (side, 1, 1))
        lathe("eye", [(0.0, ball[0][1]), *ball[1:-1], (0.0, ball[-1][1])], eyes, 18, centre, (0.25 * side, -1, 0), 180)
        tuft = smooth_path([(0.20, -0.05, 0.66), (0.255, -0.05, 0.78), (0.27, -0.03, 0.84), (0.31, 0.01, 0.90)], 10)
        radii = np.array([0.10, 0.10, 0.09, 0.08, 0.07, 0.058, 0.046, 0.033, 0.018, 0.004])
        tube_along_curve("tuft", tuft * (side, 1, 1), radii, horn, 9, 0.7)
    beak = smooth_path([(0.0, -0.30, 0.45), (0.0, -0.385, 0.44), (0.0, -0.42, 0.38), (0.0, -0.405, 0.31)], 10)
    tube_along_curve("beak", beak, np.array([0.06, 0.06, 0.058, 0.054, 0.049, 0.042, 0.034, 0.025, 0.014, 0.003]), horn, 10)


def _wings_and_tail(quills: bpy.types.Material) -> None:
    """Wings that stand off the body at their tips, and a tail of five overlapping feathers."""
    radii = np.array([0.02, 0.055, 0.07, 0.075, 0.075, 0.072, 0.068, 0.062, 0.055, 0.048, 0.040, 0.030, 0.020, 0.006])
    for side in (-1, 1):
        line = [(0.33, -0.06, 0.24), (0.43, -0.04, 0.14), (0.485, 0.00, -0.08), (0.475, 0.08, -0.32), (0.43, 0.17, -0.58)]
        path = smooth_path(line, len(radii)) * (side, 1, 1)
        tube_along_curve("wing", path, radii, quills, 14, 2.9)
    for index in (-2, 2, -1, 1, 0):
        tip, depth = np.array((0.10 * index, 0.50, -0.66)), 0.016 * (2 - abs(index))
        root, width = np.array((0.05 * index, 0.26, -0.34)), 0.05
        outline = [root - (width, 0, 0), tip - (width, 0.05, -0.07), tip, tip + (width, -0.05, 0.07), root + (width, 0, 0)]
        plate("tail", np.array(outline) + (0.0, depth, depth), (0.0, 0.012, 0.009), quills, bevel=0.004, segments=1)


def _feet(skin: bpy.types.Material, horn: bpy.types.Material) -> None:
    """Three toes a foot, which grip the stone, each with a claw."""
    for side in (-1, 1):
        for spread in (-0.5, 0.0, 0.5):
            ahead = np.array((np.sin(spread + 0.15 * side), -np.cos(spread + 0.15 * side), 0.0))
            line = [(-0.02, -0.56), (0.06, -0.535), (0.13, -0.56), (0.18, -0.615)]
            start = np.array((0.16 * side, -0.20, 0.0))
            path = smooth_path([start + s * ahead + (0, 0, z) for s, z in line], 10)
            tube_along_curve("toe", path, np.linspace(0.045, 0.030, 10), skin, 8)
            nail = [path[-2] + (0, 0, 0.004), path[-1] + 0.02 * ahead - (0, 0, 0.02), path[-1] + 0.03 * ahead - (0, 0, 0.06)]
            tube_along_curve("claw", smooth_path(nail, 6), np.linspace(0.024, 0.003, 6), horn, 7)


def _stone(paint: bpy.types.Material) -> None:
    """Flat boulder, uneven, undercut on one side."""
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    rows = []
    for r, z in ((0.22, -0.82), (0.36, -0.83), (0.43, -0.80), (0.51, -0.74), (0.53, -0.68), (0.50, -0.625), (0.42, -0.59),
                 (0.30, -0.575), (0.14, -0.57)):  # fmt: skip
        lumps = 0.5 * np.sin(3 * angle + 1.0 + 4 * z) + 0.3 * np.sin(5 * angle + 2.0) + 0.2 * np.sin(9 * angle + 9 * z)
        cut = 0.10 * np.exp(-(((angle - 3.9) / 0.5) ** 2) - ((z + 0.77) / 0.05) ** 2)
        radius = r * (1.0 + 0.09 * lumps) - cut
        rows.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), z + 0.012 * lumps], axis=1))
    grid_surface("stone", np.array(rows), paint)
