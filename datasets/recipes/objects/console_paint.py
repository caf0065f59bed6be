"""Materials of the console: used white plastic, printed icons and stripes, coloured parts, label and sticker."""

from __future__ import annotations

import bpy
from mathutils import Matrix, Vector

from .paint import Paint, Socket, Value

Triple = tuple[float, float, float]  # linear RGB, or lengths along x, y, z

WHITE, IVORY, GREY, INK = (0.80, 0.79, 0.76), (0.66, 0.61, 0.50), (0.42, 0.42, 0.43), (0.05, 0.05, 0.055)
RED, YELLOW, GREEN, BLUE = (0.72, 0.04, 0.035), (0.80, 0.52, 0.03), (0.03, 0.42, 0.10), (0.03, 0.13, 0.62)
ORANGE, TEAL = (0.80, 0.20, 0.02), (0.02, 0.34, 0.38)


def _box(s: Paint, u: Socket, v: Socket, centre: tuple[float, float], half: tuple[float, float]) -> Socket:
    """1 inside a rectangle of half size ``half`` in the (u, v) plane, 0 outside."""
    across = s.math("SUBTRACT", s.math("ABSOLUTE", s.math("SUBTRACT", u, centre[0])), half[0])
    along = s.math("SUBTRACT", s.math("ABSOLUTE", s.math("SUBTRACT", v, centre[1])), half[1])
    return s.smooth(s.math("MAXIMUM", across, along), 0.001, -0.001)


def _radius(s: Paint, u: Socket, v: Socket, centre: tuple[float, float]) -> Socket:
    """Distance from ``centre`` in the (u, v) plane."""
    square = s.math("POWER", s.math("SUBTRACT", u, centre[0]), 2.0)
    return s.math("SQRT", s.math("ADD", square, s.math("POWER", s.math("SUBTRACT", v, centre[1]), 2.0)))


def _ring(s: Paint, radius: Socket, middle: float, width: float) -> Socket:
    """1 where ``radius`` is within half a width of ``middle``, 0 elsewhere."""
    gap = s.math("ABSOLUTE", s.math("SUBTRACT", radius, middle))
    return s.smooth(gap, width / 2 + 0.001, width / 2 - 0.001)


def _fingerprints(s: Paint, at: Socket) -> Socket:
    """Ridged finger marks in some cells, and greasy smears, in [0, 1]."""
    cell = s.voronoi(at, 6.5)
    chosen = s.smooth(s.split(cell["Color"])[0], 0.50, 0.52)
    ridges = s.formula("sine(480 * distance + 75 * bend)", distance=cell["Distance"], bend=s.noise(at, 9.0))
    print_ = s.math("MULTIPLY", s.smooth(cell["Distance"], 0.062, 0.043), s.smooth(ridges, -0.5, 0.5, 0.45, 1.0))
    smears = s.smooth(s.noise(s.vector("MULTIPLY", at, (1.0, 1.4, 0.6)), 4.0, 5.0), 0.50, 0.63, 0.0, 0.7)
    return s.formula("maximum(chosen * mark, smears)", chosen=chosen, mark=print_, smears=smears)


def _scratches(s: Paint, at: Socket) -> Socket:
    """Thin lines of two directions in some places, in [0, 1]."""
    lines = [
        s.smooth(s.formula("absolute(n - 0.5)", n=s.noise(s.vector("MULTIPLY", at, scale), 5.0, 2.0)), 0.010, 0.002)
        for scale in ((0.3, 0.8, 9.0), (0.4, 8.0, 0.9))
    ]
    return s.math("MULTIPLY", s.math("MAXIMUM", *lines), s.smooth(s.noise(at, 3.1, 2.0), 0.53, 0.62))


def _worn_edges(s: Paint, at: Socket, half: Triple) -> Socket:
    """1 on the rubbed places of the edges and corners of a box of half extents ``half``."""
    x, y, z = s.split(s.vector("DIVIDE", s.vector("ABSOLUTE", at), half))
    near = s.formula("power(x, 14) + power(y, 14) + power(z, 14)", x=x, y=y, z=z)
    return s.math("MULTIPLY", s.smooth(near, 1.02, 1.30), s.smooth(s.noise(at, 9.0, 5.0), 0.44, 0.60))


def _plastic(
    s: Paint,
    at: Socket,
    colour: Value,
    aged: Value,
    roughness: tuple[float, float],
    wear: Value = 0.0,
    dirt: Value = 0.0,
) -> bpy.types.Material:
    """Used plastic: ``roughness`` of the clean surface and of finger marks; ``wear`` polishes, ``dirt`` dulls."""
    marks, lines = _fingerprints(s, at), _scratches(s, at)
    base = s.mix(s.smooth(s.noise(at, 2.2, 5.0), 0.45, 0.68), colour, aged)
    base = s.mix(s.smooth(s.noise(at, 38.0, 2.0), 0.62, 0.70, 0.0, 0.16), base, (0.40, 0.36, 0.30))
    base = s.mix(s.math("MULTIPLY", marks, 0.08), base, (0.42, 0.36, 0.27))
    base = s.mix(s.math("MULTIPLY", lines, 0.35), base, (0.36, 0.35, 0.33))
    base = s.mix(s.math("MULTIPLY", wear, 0.4), base, (0.52, 0.50, 0.47))
    base = s.mix(dirt, base, (0.34, 0.29, 0.21))
    rough = s.formula("clean + 0.25 * (n - 0.5)", clean=s.blend(marks, *roughness), n=s.noise(at, 30.0))
    rough = s.blend(s.math("MULTIPLY", lines, 0.7), rough, 0.70)
    rough = s.blend(dirt, s.blend(wear, rough, 0.28), 0.80)
    return s.finish(base, s.formula("minimum(maximum(rough, 0.2), 0.85)", rough=rough))


def _grime(s: Paint, at: Socket, above_floor: Socket) -> Socket:
    """Dirt that gathers toward the floor, in [0, 0.5]."""
    return s.math("MULTIPLY", s.smooth(above_floor, 0.155, -0.025), s.smooth(s.noise(at, 24.0, 6.0), 0.44, 0.64, 0.0, 0.5))


def shell(centre: Vector, half: Triple) -> bpy.types.Material:
    """Matt white housing with the icons printed on its front, and dust around the holes on top."""
    s = Paint("console_shell")
    at = s.local(Matrix.Translation(centre))
    x, y, z = s.split(at)
    power, disc = _radius(s, x, z, (-0.145, 0.41)), _radius(s, x, z, (-0.145, -0.36))
    icons = [
        _ring(s, power, 0.066, 0.008),
        _ring(s, disc, 0.024, 0.008),
        _ring(s, disc, 0.0, 0.016),
        _box(s, x, z, (-0.145, 0.232), (0.020, 0.0035)),
        _box(s, x, z, (-0.145, 0.246), (0.012, 0.005)),
        *(_box(s, x, z, (-0.18 + 0.022 * bar, -0.555), (0.005, 0.008 + 0.005 * bar)) for bar in range(4)),
    ]
    front = s.smooth(y, -half[1] + 0.02, -half[1] + 0.01)
    white: Value = WHITE
    for icon in icons:
        white = s.mix(s.math("MULTIPLY", front, icon), white, (0.16, 0.17, 0.19))
    on_top = s.math("MULTIPLY", s.smooth(z, half[2] - 0.055, half[2]), s.smooth(s.noise(at, 7.0, 5.0), 0.46, 0.66, 0.0, 0.25))
    dirt = s.math("MAXIMUM", _grime(s, at, s.math("ADD", z, half[2])), on_top)
    aged = s.mix(0.30, white, IVORY)
    return _plastic(s, at, white, aged, (0.66, 0.38), _worn_edges(s, at, half), dirt)


def gloss(centre: Vector, half: Triple) -> bpy.types.Material:
    """Glossy white side plate with two printed stripes."""
    s = Paint("console_gloss")
    at = s.local(Matrix.Translation(centre))
    _, y, z = s.split(at)
    slope = s.formula("0.8 * y + 0.6 * z", y=y, z=z)
    chipped = s.smooth(s.noise(at, 26.0, 5.0), 0.33, 0.38)
    white = s.mix(s.math("MULTIPLY", _ring(s, slope, 0.40, 0.11), chipped), (0.84, 0.84, 0.82), ORANGE)
    white = s.mix(s.math("MULTIPLY", _ring(s, slope, 0.495, 0.035), chipped), white, TEAL)
    aged = s.mix(0.15, white, IVORY)
    return _plastic(s, at, white, aged, (0.23, 0.46), _worn_edges(s, at, half), _grime(s, at, s.math("ADD", z, half[2])))


def plain(name: str, colour: Triple, roughness: tuple[float, float]) -> bpy.types.Material:
    """Coloured plastic that has faded a little in places."""
    s = Paint(name)
    faded = s.mix(0.22, colour, IVORY)
    return _plastic(s, s.position(), colour, faded, roughness)


def dark(name: str, colour: Triple, roughness: tuple[float, float]) -> bpy.types.Material:
    """Insides and rubber: dark, with pale dust in patches; ``roughness`` without and with dust."""
    s = Paint(name)
    dust = s.smooth(s.noise(s.position(), 14.0, 5.0), 0.45, 0.72)
    base = s.mix(s.math("MULTIPLY", dust, 0.5), colour, (0.20, 0.18, 0.15))
    return s.finish(base, s.blend(dust, *roughness))


def label(at: Matrix, half: tuple[float, float]) -> bpy.types.Material:
    """Type label of half size ``half`` in the frame ``at``: a coloured head, rows of print, a bar code."""
    s = Paint("console_label")
    width, height = half
    place = s.local(at)
    u, v, _ = s.split(place)
    row = s.formula("fract((v + 1) * density)", v=v, density=6.0 / height)
    words = s.smooth(s.noise(s.vector("MULTIPLY", place, (1.0, 0.4, 0.0)), 55.0, 1.0), 0.44, 0.48)
    text = s.formula("low * high * words", low=s.smooth(row, 0.65, 0.55), high=s.smooth(row, 0.08, 0.18), words=words)
    body = _box(s, u, v, (-0.30 * width, -0.15 * height), (0.60 * width, 0.65 * height))
    bars = s.smooth(s.noise(s.vector("MULTIPLY", place, (1.0, 0.0, 0.0)), 90.0, 1.0), 0.49, 0.51)
    code = _box(s, u, v, (0.65 * width, -0.20 * height), (0.22 * width, 0.45 * height))
    base = s.mix(s.smooth(s.noise(place, 5.0, 4.0), 0.42, 0.66), (0.76, 0.75, 0.70), (0.60, 0.54, 0.40))
    base = s.mix(s.math("MULTIPLY", body, text), base, INK)
    base = s.mix(s.math("MULTIPLY", code, bars), base, INK)
    base = s.mix(s.smooth(v, 0.58 * height, 0.62 * height), base, BLUE)
    base = s.mix(_box(s, u, v, (-0.70 * width, 0.80 * height), (0.20 * width, 0.09 * height)), base, YELLOW)
    return s.finish(base, s.smooth(s.noise(place, 9.0, 5.0), 0.42, 0.62, 0.28, 0.55))


def sticker(at: Matrix, radius: float) -> bpy.types.Material:
    """Round sticker in the frame ``at``: a rising sun over waves, scuffed."""
    s = Paint("console_sticker")
    place = s.local(at)
    u, v, _ = s.split(place)
    base = s.mix(s.smooth(s.formula("sine(14 * arctan2(v, u))", u=u, v=v), -0.12, 0.12), YELLOW, ORANGE)
    base = s.mix(s.smooth(_radius(s, u, v, (0.0, -0.1 * radius)), 0.47 * radius, 0.44 * radius), base, RED)
    wave = s.formula("v + 0.01 * sine(75 * u)", u=u, v=v)
    for level, colour in ((-0.25, TEAL), (-0.45, (0.66, 0.70, 0.66)), (-0.58, BLUE)):
        base = s.mix(s.smooth(wave, level * radius + 0.002, level * radius - 0.002), base, colour)
    base = s.mix(s.smooth(_radius(s, u, v, (0.0, 0.0)), 0.90 * radius, 0.92 * radius), base, (0.78, 0.77, 0.72))
    scuffs = s.smooth(s.noise(place, 24.0, 6.0), 0.60, 0.66)
    base = s.mix(s.math("MULTIPLY", scuffs, 0.8), base, (0.62, 0.60, 0.55))
    return s.finish(base, s.blend(scuffs, s.smooth(s.noise(place, 8.0, 4.0), 0.42, 0.6, 0.24, 0.42), 0.7))
