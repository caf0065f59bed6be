"""Printed paints of the books: covers, pages, and the edges of pages.

All read the mesh attribute 'chart' of `book.slab`: two coordinates on a face in the part's own units, and which face it is.
Letters are made of strokes drawn by lot, so that they look like print and say nothing.
"""

from __future__ import annotations

import functools

import bpy

from .paint import Paint, Socket, Value

FRONT, PLAIN, BACK, RIM = 0.0, 0.3, 1.0, -1.0
"""The third number of a chart; PLAIN is a front without a title. Pages have 0, 1, 2, ... for what is printed on them."""

OCHRE, INK, CREAM = (0.52, 0.34, 0.09), (0.075, 0.065, 0.06), (0.76, 0.70, 0.56)


# ---------------------------------------------------------------- print
def below(paint: Paint, value: Value, start: float, end: float) -> Socket:
    """1 up to `start`, 0 from `end` on."""
    return paint.smooth(value, start, end, 1.0, 0.0)


def within(paint: Paint, value: Value, low: float, high: float, soft: float) -> Socket:
    """1 where a value lies from `low` to `high`, over an edge `soft` wide."""
    return both(paint, paint.smooth(value, low - soft, low + soft), below(paint, value, high - soft, high + soft))


def both(paint: Paint, *values: Value) -> Socket:
    """Product of weights."""
    return functools.reduce(lambda a, b: paint.math("MULTIPLY", a, b), values)


def any_of(paint: Paint, *values: Value) -> Socket:
    """Largest of some weights."""
    return functools.reduce(lambda a, b: paint.math("MAXIMUM", a, b), values)


def letters(paint: Paint, along: Socket, up: Socket, seed: float, spaces: float = 0.0) -> Socket:
    """Ink of a line of capitals: one letter for every unit of `along`, `up` from 0 to 1 over its height.

    A letter has a stem on its left, and by lot one on its right and bars above, amid and below; `spaces` of them are blank.
    """
    number, inside = paint.math("FLOOR", along), paint.formula("fract(a) / 0.74", a=along)

    def lot(kind: float, share: float) -> Socket:
        return paint.math("LESS_THAN", paint.random(paint.join(number, seed, kind)), share)

    stem = below(paint, inside, 0.24, 0.30)
    right = both(paint, paint.smooth(inside, 0.70, 0.76), lot(1.0, 0.45))
    top = both(paint, paint.smooth(up, 0.78, 0.84), lot(2.0, 0.62))
    amid = both(paint, within(paint, up, 0.41, 0.59, 0.03), lot(3.0, 0.6))
    bottom = both(paint, below(paint, up, 0.16, 0.22), lot(4.0, 0.6))
    stroke = any_of(paint, stem, right, top, amid, bottom)
    box = paint.formula("less_than(i, 1) * greater_than(v, 0) * less_than(v, 1)", i=inside, v=up)
    return paint.formula("s * b * (1 - g)", s=stroke, b=box, g=lot(5.0, spaces))


def text(paint: Paint, u: Socket, v: Socket, seed: Value, pitch: float, word: float) -> Socket:
    """Ink of lines `pitch` apart along v, of words about `word` long along u; u runs from 0 to 1 within the margins."""
    line, inside = paint.formula("floor(v / p)", v=v, p=pitch), paint.formula("fract(v / p)", v=v, p=pitch)
    chance = paint.random(paint.join(line, seed, 3.0))
    place = paint.formula("u / w + 7 * c", u=u, w=word, c=chance)
    cell = paint.math("FLOOR", place)
    gap = paint.formula("0.15 + 0.35 * r", r=paint.random(paint.join(cell, line, seed)))
    words = paint.math("GREATER_THAN", paint.math("FRACT", place), gap)
    shape = paint.formula("0.75 + 0.25 * sine(u * 230 + 40 * c)", u=u, c=chance)
    end = paint.formula("1 - 0.7 * greater_than(c, 0.84) * c * c", c=chance)
    inked = paint.formula("w * s * greater_than(u, 0) * less_than(u, e)", w=words, s=shape, u=u, e=end)
    return both(paint, inked, within(paint, inside, 0.24, 0.72, 0.06))


def page(width: float, height: float) -> bpy.types.Material:
    """Yellowed leaves: on some a plate in brown ink, on the rest text, a red initial and foxing; grey lines on the edges."""
    paint = Paint("page")
    u, v, kind = paint.split(paint.attribute("chart"))
    p = paint.position()
    rim = paint.math("LESS_THAN", kind, -0.5)
    edge = paint.formula("minimum(minimum(v, h - v), (1 - u) * w)", u=u, v=v, h=height, w=width)
    blotch = paint.noise(p, 4.0)
    aged = paint.formula("minimum(1, e + 0.5 * (n - 0.45))", e=paint.smooth(edge, 0.0, 0.16, 0.85, 0.0), n=blotch)
    paper = paint.mix(any_of(paint, aged, 0.0), (0.74, 0.66, 0.50), (0.50, 0.35, 0.17))
    fox = paint.smooth(paint.noise(p, 19.0, 1.0), 0.71, 0.76, 0.0, 0.6)
    paper = paint.mix(fox, paper, (0.40, 0.22, 0.09))

    inner, up = paint.formula("(u - 0.20) / 0.62", u=u), paint.formula("v - 0.12", v=v)
    block = paint.formula("greater_than(v, 0.12) * less_than(v, h)", v=v, h=height - 0.13)
    initial = paint.formula("less_than(u, 0.2) * greater_than(v, t)", u=inner, t=height - 0.26, v=v)
    ink = paint.formula("t * b * (1 - i)", t=text(paint, inner, up, kind, 0.044, 0.17), b=block, i=initial)
    initial = paint.formula("i * b * greater_than(u, 0)", i=initial, b=block, u=inner)
    printed = paint.mix(both(paint, ink, 0.9), paper, INK)
    letter = letters(
        paint, paint.formula("u / 0.26 + 3 * k", u=inner, k=kind), paint.formula("(v - t) / 0.12", v=v, t=height - 0.255), 2.0
    )
    printed = paint.mix(initial, printed, paint.mix(letter, (0.55, 0.10, 0.05), CREAM))

    plate = paint.math("COMPARE", kind, 3.0, 0.1)
    x, y = paint.formula("(u - 0.5) * w", u=u, w=width), paint.formula("v - h", v=v, h=0.56 * height)
    oval = paint.formula("sqrt(x * x / 0.045 + y * y / 0.11)", x=x, y=y)
    hill = paint.formula("y + 0.10 - 0.05 * sine(x * 11 + 1) - 0.03 * sine(x * 27)", x=x, y=y)
    moon = paint.formula("sqrt((x + 0.07) * (x + 0.07) + (y - 0.13) * (y - 0.13))", x=x, y=y)
    sky = paint.formula("0.35 + 0.35 * sine(y * 150)", y=y)
    land = paint.formula("0.72 + 0.28 * sine(x * 120 + y * 170)", x=x, y=y)
    tone = paint.blend(paint.smooth(hill, -0.006, 0.006), land, sky)
    tone = both(paint, tone, paint.smooth(moon, 0.050, 0.058))
    tone = any_of(paint, both(paint, tone, below(paint, oval, 0.96, 1.0)), within(paint, oval, 1.05, 1.10, 0.01))
    legend = letters(paint, paint.formula("x / 0.034 + 20", x=x), paint.formula("(v - 0.10) / 0.05", v=v), 8.0, 0.15)
    legend = both(paint, legend, within(paint, x, -0.17, 0.17, 0.002))
    engraved = paint.mix(both(paint, any_of(paint, tone, legend), 0.85), paper, (0.16, 0.075, 0.04))
    face = paint.mix(plate, printed, engraved)

    lines = paint.noise(paint.join(paint.formula("u * 3", u=u), paint.formula("v * 26", v=v), 0.0), 1.0, 2.0)
    cut = paint.mix(paint.smooth(lines, 0.35, 0.65), (0.44, 0.33, 0.19), (0.70, 0.60, 0.42))
    return paint.finish(paint.mix(rim, face, cut), paint.formula("0.90 - 0.12 * i", i=ink))


def page_edges(name: str, sprinkled: bool) -> bpy.types.Material:
    """Cut edges of a lying block: fine lines along the leaves, brown from dust on top; old ones sprinkled with red."""
    paint = Paint(name)
    s, t, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    lines = paint.noise(paint.join(paint.formula("s * 1.5", s=s), paint.formula("t * 19", t=t), 0.0), 1.0, 3.0)
    deckle = paint.smooth(paint.noise(p, 3.5), 0.35, 0.65)
    light, dark = ((0.66, 0.54, 0.34), (0.40, 0.27, 0.13)) if sprinkled else ((0.74, 0.67, 0.52), (0.55, 0.43, 0.25))
    colour = paint.mix(paint.formula("0.75 * l + 0.35 * (1 - d)", l=below(paint, lines, 0.36, 0.62), d=deckle), light, dark)
    if sprinkled:
        drops = paint.smooth(paint.noise(p, 30.0, 0.0), 0.60, 0.66)
        colour = paint.mix(both(paint, drops, 0.8), colour, (0.42, 0.10, 0.07))
    return paint.finish(colour, paint.blend(deckle, 0.93, 0.84))


def cover(height: float, width: float) -> bpy.types.Material:
    """Paperback: a red sun over hills and a lake, a title in capitals, soft gloss; white where edges and creases are rubbed."""
    paint = Paint("cover")
    along, across, kind = paint.split(paint.attribute("chart"))
    p = paint.position()
    x = paint.formula("y / w", y=across, w=width)  # from -0.5 at the spine to the right
    up = paint.formula("0.5 - x / h", x=along, h=height)
    grain = paint.noise(p, 55.0, 1.0)
    sky = paint.mix(paint.smooth(up, 0.40, 0.95), (0.80, 0.58, 0.27), (0.06, 0.22, 0.30))
    rays = paint.formula("0.5 + 0.5 * sine(arctan2(y - 0.47, x - 0.08) * 26)", x=x, y=up)
    sun = paint.formula("sqrt((x - 0.08) * (x - 0.08) + (y - 0.47) * (y - 0.47) * a)", x=x, y=up, a=(height / width) ** 2)
    sky = paint.mix(
        paint.formula("0.30 * r * s", r=paint.smooth(rays, 0.4, 0.6), s=below(paint, sun, 0.20, 0.62)), sky, (0.84, 0.72, 0.42)
    )
    sky = paint.mix(below(paint, sun, 0.190, 0.198), sky, (0.74, 0.12, 0.05))
    bird = paint.formula("absolute(y - 0.64 - 0.18 * absolute(x + 0.26))", x=x, y=up)
    bird = both(paint, below(paint, bird, 0.006, 0.010), within(paint, x, -0.35, -0.17, 0.004))
    picture = paint.mix(bird, sky, INK)
    for base, swell, wave, start, colour in (
        (0.46, 0.045, 9.0, 0.5, (0.30, 0.34, 0.36)), (0.415, 0.035, 13.0, 2.0, (0.13, 0.22, 0.20)),
    ):  # fmt: skip
        ridge = paint.formula(
            "y - b - a * sine(x * f + s) - 0.3 * a * sine(x * f * 2.7)", y=up, x=x, b=base, a=swell, f=wave, s=start
        )
        picture = paint.mix(below(paint, ridge, -0.003, 0.003), picture, colour)
    glitter = paint.formula(
        "sine(y * 210) * 0.5 + n", y=up, n=paint.noise(paint.join(both(paint, x, 9.0), both(paint, up, 40.0), 0.0), 1.0)
    )
    streak = both(
        paint, paint.smooth(glitter, 0.45, 0.6), paint.smooth(paint.formula("absolute(x - 0.08)", x=x), 0.06, 0.24, 1.0, 0.12)
    )
    lake = paint.mix(streak, paint.mix(paint.smooth(up, 0.27, 0.40), (0.05, 0.20, 0.30), (0.28, 0.42, 0.40)), (0.80, 0.50, 0.20))
    picture = paint.mix(below(paint, up, 0.397, 0.401), picture, lake)
    panel = within(paint, up, 0.035, 0.262, 0.002)
    panel = both(paint, panel, within(paint, x, -0.45, 0.45, 0.003))
    frame = both(paint, within(paint, up, 0.047, 0.250, 0.002), within(paint, x, -0.433, 0.433, 0.003))
    title = paint.mix(frame, (0.09, 0.20, 0.24), CREAM)
    for low, tall, pitch, half, seed, ink in (
        (0.165, 0.068, 0.092, 0.37, 3.0, (0.62, 0.09, 0.04)), (0.098, 0.045, 0.066, 0.33, 11.0, INK),
        (0.062, 0.018, 0.030, 0.24, 5.0, INK),
    ):  # fmt: skip
        line = letters(
            paint, paint.formula("x / p + 40", x=x, p=pitch), paint.formula("(y - l) / t", y=up, l=low, t=tall), seed, 0.08
        )
        title = paint.mix(both(paint, line, within(paint, x, -half, half, 0.002)), title, ink)
    front = paint.mix(panel, picture, title)

    blurb = text(paint, paint.formula("x / 0.7 + 0.5", x=x), up, 4.0, 0.04, 0.12)
    blurb = both(paint, blurb, within(paint, up, 0.25, 0.85, 0.002))
    back = paint.mix(blurb, (0.66, 0.68, 0.62), (0.09, 0.20, 0.24))
    colour = paint.mix(paint.smooth(kind, 0.4, 0.6), front, back)
    edge = paint.formula("minimum(0.5 * h - absolute(a), 0.5 * w - absolute(c))", h=height, a=along, w=width, c=across)
    rubbed = below(
        paint, paint.formula("e + 0.022 * (n - 0.5) + 0.02 * (m - 0.5)", e=edge, n=grain, m=paint.noise(p, 9.0)), 0.002, 0.012
    )
    crease = paint.formula("absolute(c + w + 0.004 * sine(a * 30))", c=across, a=along, w=0.5 * width - 0.055)
    fold = paint.formula("absolute(c + a * 0.55 - k)", c=across, a=along, k=0.5 * width + 0.5 * height * 0.55 - 0.14)
    worn = both(paint, below(paint, paint.math("MINIMUM", crease, fold), 0.002, 0.007), paint.smooth(grain, 0.35, 0.6))
    worn = any_of(paint, worn, rubbed, paint.math("LESS_THAN", kind, -0.5))
    scuffs = paint.smooth(paint.noise(p, 6.0), 0.45, 0.70, 0.0, 0.20)
    return paint.finish(paint.mix(worn, colour, (0.74, 0.71, 0.64)), paint.blend(worn, paint.formula("0.25 + s", s=scuffs), 0.80))


def cover_back(height: float) -> bpy.types.Material:
    """Back of the paperback: the title once more between bands, pale creases where it was opened."""
    paint = Paint("cover back")
    along, turn, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    up = paint.formula("(t - 0.28) / 0.44", t=turn)
    ink = letters(paint, paint.formula("40 + a / 0.05", a=along), up, 3.0, 0.08)
    ink = both(paint, ink, within(paint, along, -0.22, 0.36, 0.002))
    band = below(paint, paint.formula("absolute(absolute(a) - h)", a=along, h=0.44 * height), 0.016, 0.019)
    colour = paint.mix(ink, (0.075, 0.20, 0.25), CREAM)
    colour = paint.mix(band, colour, (0.70, 0.12, 0.05))
    crack = paint.smooth(
        paint.formula("absolute(t - 0.5 + 0.05 * sine(a * 23)) - 0.03 * n", t=turn, a=along, n=paint.noise(p, 30.0)),
        0.0,
        0.03,
        0.8,
        0.0,
    )
    return paint.finish(paint.mix(crack, colour, (0.70, 0.66, 0.58)), paint.blend(crack, 0.30, 0.75))
