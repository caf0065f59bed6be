"""Paints of the books' bindings: cloth with stamped foil, leather, marbled paper, a woven ribbon. `book_print.py` has the rest.

All read the mesh attribute 'chart' of `book.slab`, as the printed ones do.
"""

from __future__ import annotations

import bpy

from .book_print import CREAM, OCHRE, any_of, below, both, letters, within
from .paint import Paint, Socket, Value

HUBS = (-0.34, -0.17, 0.0, 0.17, 0.34)
"""Raised bands of the ledger's back, as shares of its length from the middle."""


def weave(paint: Paint, u: Socket, v: Socket) -> Socket:
    """Threads of book cloth, 0 to 1; thicker ones here and there."""
    threads = paint.formula("0.5 + 0.25 * sine(u * 170) + 0.25 * sine(v * 170)", u=u, v=v)
    slub = paint.noise(paint.join(both(paint, u, 60.0), both(paint, v, 5.0), 0.0), 1.0, 1.0)
    return paint.formula("0.6 * t + 0.4 * s", t=threads, s=slub)


def cloth_colours(paint: Paint, thread: Socket, faded: Socket, rubbed: Socket) -> Socket:
    """Green cloth, paler where the sun bleached it, its grey board showing where it is rubbed through."""
    green = paint.mix(thread, (0.035, 0.105, 0.080), (0.085, 0.215, 0.150))
    green = paint.mix(faded, green, paint.mix(thread, (0.17, 0.20, 0.12), (0.31, 0.33, 0.20)))
    return paint.mix(rubbed, green, (0.50, 0.43, 0.32))


def cloth(width: float, height: float) -> bpy.types.Material:
    """Boards: woven cloth with a stamped frame, corners of leaves and a rosette in ochre foil, worn off in places."""
    paint = Paint("cloth")
    along, across, kind = paint.split(paint.attribute("chart"))  # height from the middle, outward from the middle
    p = paint.position()
    thread, patch = weave(paint, along, across), paint.noise(p, 3.2)
    edge = paint.formula("minimum(0.5 * h - absolute(a), 0.5 * w - absolute(c))", h=height, a=along, w=width, c=across)
    corner = paint.formula("(0.5 * h - absolute(a)) + (0.5 * w - absolute(c))", h=height, a=along, w=width, c=across)
    near = paint.math("MINIMUM", paint.formula("e * 3", e=edge), corner)
    rubbed = below(paint, paint.formula("n + 0.06 * (g - 0.5)", n=near, g=paint.noise(p, 16.0)), 0.020, 0.050)
    rubbed = paint.blend(paint.math("LESS_THAN", kind, -0.5), rubbed, paint.smooth(paint.noise(p, 6.0), 0.44, 0.58))
    faded = paint.formula("minimum(1, 0.6 * s + f)", s=paint.smooth(patch, 0.45, 0.75), f=paint.smooth(edge, 0.0, 0.10, 0.45, 0.0))

    line = any_of(paint, within(paint, edge, 0.060, 0.072, 0.002), within(paint, edge, 0.084, 0.090, 0.002))
    r, turn = paint.formula("sqrt(a * a + c * c)", a=along, c=across), paint.formula("arctan2(a, c)", a=along, c=across)
    petals = paint.formula("r - 0.085 - 0.045 * absolute(cosine(t * 4))", r=r, t=turn)
    rosette = both(paint, below(paint, petals, -0.003, 0.003), paint.smooth(r, 0.044, 0.050))
    rosette = any_of(paint, rosette, below(paint, r, 0.026, 0.031))
    rosette = any_of(paint, rosette, within(paint, r, 0.150, 0.160, 0.002))
    i, j = (
        paint.formula("absolute(a) - m", a=along, m=0.5 * height - 0.16),
        paint.formula("absolute(c) - m", c=across, m=0.5 * width - 0.16),
    )
    leaf = paint.formula("sqrt(i * i + j * j) - 0.020 - 0.030 * absolute(sine(arctan2(i, j) * 2))", i=i, j=j)
    title = letters(paint, paint.formula("c / 0.055 + 30", c=across), paint.formula("(a - 0.25) / 0.075", a=along), 21.0, 0.06)
    title = both(paint, title, within(paint, across, -0.165, 0.165, 0.001), paint.math("LESS_THAN", kind, 0.1))
    stamp = any_of(paint, line, rosette, title, below(paint, leaf, -0.003, 0.003))
    stamp = paint.formula(
        "s * k * (1 - b) * less_than(absolute(f), 0.5)", s=stamp, k=paint.smooth(paint.noise(p, 11.0), 0.34, 0.44), b=rubbed, f=kind
    )
    lining = paint.formula("greater_than(k, 0.9) * greater_than(e, 0.024)", k=kind, e=edge)
    paper = paint.mix(patch, (0.56, 0.44, 0.28), (0.70, 0.60, 0.42))
    colour = paint.mix(lining, cloth_colours(paint, thread, faded, rubbed), paper)
    colour = paint.mix(stamp, colour, OCHRE)
    return paint.finish(colour, paint.blend(stamp, paint.formula("0.94 - 0.10 * t", t=thread), 0.36))


def cloth_back(height: float) -> bpy.types.Material:
    """Back of the open book: bleached, with a title on a red label and lines of foil."""
    paint = Paint("cloth back")
    up, turn, kind = paint.split(paint.attribute("chart"))
    p = paint.position()
    side = paint.formula("0 - t * 0.13", t=turn)  # to the right, as the back is seen
    thread = weave(paint, up, side)
    ends = paint.formula("minimum(v, h - v)", v=up, h=height)
    rubbed = below(paint, paint.formula("e + 0.03 * (n - 0.5)", e=ends, n=paint.noise(p, 18.0)), 0.008, 0.028)
    rubbed = any_of(paint, rubbed, paint.math("LESS_THAN", kind, -0.5))
    faded = paint.smooth(paint.formula("absolute(t) + 0.4 * (n - 0.5)", t=turn, n=paint.noise(p, 5.0)), 0.3, 1.0, 0.95, 0.35)
    label = both(paint, within(paint, up, 0.72, 0.93, 0.002), below(paint, paint.math("ABSOLUTE", turn), 0.72, 0.76))
    upper = letters(paint, paint.formula("s / 0.037 + 10", s=side), paint.formula("(v - 0.835) / 0.055", v=up), 31.0)
    lower = letters(paint, paint.formula("s / 0.037 + 20", s=side), paint.formula("(v - 0.755) / 0.055", v=up), 31.0)
    ink = any_of(paint, upper, lower)
    foil = both(paint, ink, label, within(paint, side, -0.074, 0.074, 0.001))
    lines = paint.formula("absolute(absolute(absolute(v - 0.5 * h) - 0.25) - 0.18)", v=up, h=height)
    foil = any_of(paint, foil, below(paint, lines, 0.005, 0.007))
    foil = both(paint, foil, paint.smooth(paint.noise(p, 12.0), 0.32, 0.42))
    colour = paint.mix(label, cloth_colours(paint, thread, faded, rubbed), (0.40, 0.055, 0.045))
    colour = paint.mix(foil, colour, OCHRE)
    return paint.finish(colour, paint.blend(foil, paint.blend(label, 0.88, 0.48), 0.36))


def leather(paint: Paint, bare: Value) -> tuple[Socket, Socket]:
    """Calf, dark and half gloss, tan and dull where it is `bare` (0 to 1): colour and roughness."""
    p = paint.position()
    pores = paint.smooth(paint.voronoi(p, 45.0)["Distance"], 0.002, 0.010)
    patch = paint.noise(p, 5.0)
    dark = paint.mix(paint.smooth(patch, 0.35, 0.65), (0.11, 0.040, 0.022), (0.21, 0.085, 0.040))
    colour = paint.mix(both(paint, pores, 0.35), dark, (0.27, 0.125, 0.065))
    worn = paint.math("MINIMUM", any_of(paint, paint.formula("b + 1.2 * (n - 0.55)", b=bare, n=paint.noise(p, 14.0)), 0.0), 1.0)
    return paint.mix(worn, colour, (0.48, 0.29, 0.15)), paint.blend(worn, paint.formula("0.38 + 0.14 * p", p=pores), 0.80)


def leather_back() -> bpy.types.Material:
    """Back of the ledger: calf over raised bands, rubbed on them, ochre lines beside them, a black label with a title."""
    paint = Paint("leather back")
    along, turn, _ = paint.split(paint.attribute("chart"))
    up = paint.formula("a / 1.14", a=along)
    nearest: Value = 1.0
    for hub in HUBS:
        nearest = paint.math("MINIMUM", nearest, paint.formula("absolute(u - h)", u=up, h=hub))
    bare = any_of(
        paint, paint.smooth(nearest, 0.006, 0.016, 0.75, 0.05), paint.smooth(paint.math("ABSOLUTE", up), 0.47, 0.50, 0.0, 0.9)
    )
    hide, rough = leather(paint, bare)
    line = within(paint, nearest, 0.022, 0.029, 0.001)
    label = both(paint, within(paint, up, 0.20, 0.31, 0.002), below(paint, paint.math("ABSOLUTE", turn), 0.60, 0.63))
    ink = both(
        paint, letters(paint, paint.formula("4.5 - t * 4.5", t=turn), paint.formula("(u - 0.225) / 0.06", u=up), 41.0), label
    )
    foil = both(paint, any_of(paint, line, ink), paint.smooth(paint.noise(paint.position(), 13.0), 0.33, 0.43))
    colour = paint.mix(foil, paint.mix(label, hide, (0.045, 0.040, 0.038)), OCHRE)
    return paint.finish(colour, paint.blend(foil, paint.blend(label, rough, 0.34), 0.32))


def half_leather(height: float, width: float) -> bpy.types.Material:
    """Boards of the ledger: combed marbled paper, corners and a strip along the back of leather with a line beside them."""
    paint = Paint("half leather")
    along, across, kind = paint.split(paint.attribute("chart"))
    p = paint.position()
    comb = paint.formula("absolute(fract(a * 6) - 0.5) * 1.6", a=along)
    drift = paint.formula("c * 13 + k + 1.8 * n", c=across, k=comb, n=paint.noise(p, 5.0, 2.0))
    vein, inside = paint.math("FLOOR", drift), paint.math("FRACT", drift)
    chance = paint.random(paint.join(vein, 2.0, 0.0))
    colour = paint.mix(paint.math("GREATER_THAN", chance, 0.28), (0.40, 0.065, 0.045), (0.055, 0.12, 0.26))
    colour = paint.mix(paint.math("GREATER_THAN", chance, 0.55), colour, (0.70, 0.58, 0.36))
    colour = paint.mix(paint.math("GREATER_THAN", chance, 0.82), colour, (0.42, 0.30, 0.08))
    colour = paint.mix(
        paint.smooth(paint.formula("minimum(i, 1 - i)", i=inside), 0.06, 0.13, 0.9, 0.0), colour, (0.10, 0.05, 0.045)
    )

    side = paint.formula("c + w", c=across, w=0.5 * width)
    corner = paint.formula("(0.5 * h - absolute(a)) + (w - c)", h=height, a=along, w=0.5 * width - 0.022, c=across)
    inner = paint.math("MINIMUM", paint.formula("s - 0.17", s=side), paint.formula("(q - 0.21) * 0.7", q=corner))
    hidden = below(paint, inner, -0.002, 0.002)
    edge = paint.formula("minimum(0.5 * h - absolute(a), w - absolute(c))", h=height, a=along, w=0.5 * width - 0.022, c=across)
    bare = any_of(paint, paint.smooth(edge, 0.0, 0.035, 0.95, 0.0), paint.math("LESS_THAN", kind, -0.5))
    hide, rough = leather(paint, bare)
    scuffed = both(paint, below(paint, paint.formula("e + 0.05 * (n - 0.5)", e=edge, n=paint.noise(p, 12.0)), 0.0, 0.022), 0.9)
    colour = paint.mix(scuffed, colour, (0.50, 0.42, 0.30))
    colour = paint.mix(hidden, colour, hide)
    tooled = within(paint, inner, -0.016, -0.009, 0.001)
    colour = paint.mix(tooled, colour, OCHRE)
    return paint.finish(colour, paint.blend(hidden, paint.blend(scuffed, 0.42, 0.85), rough))


# ---------------------------------------------------------------- textile
def ribbon() -> bpy.types.Material:
    """Woven satin marker: ribs across, plain edges, faded and frayed pale at its end."""
    paint = Paint("ribbon")
    along, across, _ = paint.split(paint.attribute("chart"))
    rib = paint.formula("0.5 + 0.5 * sine(u * 300)", u=along)
    old = paint.smooth(paint.formula("u + 0.5 * (n - 0.5)", u=along, n=paint.noise(paint.position(), 8.0)), 1.6, 2.3)
    satin = paint.mix(rib, (0.36, 0.028, 0.050), (0.58, 0.075, 0.075))
    satin = paint.mix(both(paint, old, 0.6), satin, (0.70, 0.36, 0.28))
    edge = paint.smooth(paint.math("ABSOLUTE", across), 0.019, 0.022)
    satin = paint.mix(edge, satin, (0.66, 0.42, 0.14))
    return paint.finish(satin, paint.formula("0.36 + 0.22 * r + 0.2 * o", r=rib, o=old))


def headband() -> bpy.types.Material:
    """Silk over cord in stripes of red and cream."""
    paint = Paint("headband")
    u, v, _ = paint.split(paint.attribute("chart"))
    stripe = paint.smooth(paint.formula("absolute(fract(v * 7 + 0.15 * u) - 0.5)", u=u, v=v), 0.23, 0.27)
    return paint.finish(paint.mix(stripe, (0.55, 0.08, 0.06), CREAM), 0.6)
