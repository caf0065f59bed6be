"""Paints of the straw hat: braided straw, printed ribbon, binding, thread, walnut.

Patterns that follow a strip use the mesh attribute 'chart'. Braid: length along it, position across one turn
from 0 to 1, number of the turn (from 1; from 101 under the brim). Ribbon and binding: length along, distance across.
"""

from __future__ import annotations

import bpy

from .paint import Paint


def straw() -> bpy.types.Material:
    """Herringbone braid of dried straw: a strand is one slanted stripe on either side of the middle of a turn."""
    paint = Paint("straw")
    along, across, turn = paint.split(paint.attribute("chart"))
    under = paint.math("GREATER_THAN", turn, 99.0)
    off_middle = paint.formula("absolute(v - 0.5) * 2", v=across)
    phase = paint.formula("u / 0.032 + a * 0.95", u=along, a=off_middle)
    strand, inside = paint.math("FLOOR", phase), paint.math("FRACT", phase)
    side = paint.formula("greater_than(v, 0.5) + 2 * t", v=across, t=turn)
    lottery = paint.random(paint.join(strand, side, 0.0))
    odd = paint.random(paint.join(strand, side, 7.0))
    lane = paint.formula("f * 9 + s * 3.7", f=inside, s=strand)  # fibres run along the strand
    fibre = paint.noise(paint.join(lane, off_middle, paint.formula("t * 1.3", t=side)), 1.6, 2.0)
    bleach = paint.noise(paint.position(), 2.3, 3.0)
    blotch = paint.noise(paint.position(), 7.0, 3.0)
    tone = paint.formula(
        "0.5 + (r - 0.5) * 0.5 + (f - 0.5) * 1.0 + (b - 0.44) * 1.2 + (c - 0.5) * 0.6 - 0.14 * d",
        r=lottery, f=fibre, b=bleach, c=blotch, d=under,
    )  # fmt: skip
    blade = paint.mix(paint.smooth(tone, 0.0, 0.5), (0.34, 0.185, 0.065), (0.62, 0.415, 0.165))
    blade = paint.mix(paint.smooth(tone, 0.45, 0.95), blade, (0.84, 0.69, 0.43))
    blade = paint.mix(paint.smooth(odd, 0.955, 0.965), blade, (0.36, 0.31, 0.14))  # cut too green
    blade = paint.mix(paint.smooth(odd, 0.03, 0.04, 1.0, 0.0), blade, (0.29, 0.14, 0.055))  # scorched
    slit = paint.formula("minimum(f, 1 - f)", f=inside)
    shown = paint.formula(
        "(0.25 + 0.75 * s) * (0.4 + 0.6 * e) * (0.72 + 0.28 * m)",
        s=paint.smooth(slit, 0.0, 0.17), e=paint.smooth(off_middle, 0.80, 1.0, 1.0, 0.0),
        m=paint.smooth(off_middle, 0.0, 0.16),
    )  # fmt: skip
    colour = paint.mix(shown, (0.13, 0.065, 0.025), blade)
    roughness = paint.formula(
        "minimum(0.92, maximum(0.38, 0.86 - 0.30 * s - 0.22 * (t - 0.5) + 0.25 * (c - 0.5)))", s=shown, t=tone, c=blotch
    )
    return paint.finish(colour, roughness)


def loose_straw() -> bpy.types.Material:
    """Straw of the frays, pale with darker stretches."""
    paint = Paint("loose straw")
    tone = paint.noise(paint.position(), 14.0)
    colour = paint.mix(paint.smooth(tone, 0.35, 0.65), (0.50, 0.30, 0.11), (0.80, 0.63, 0.36))
    return paint.finish(colour, paint.formula("0.85 - 0.4 * t", t=tone))


def grosgrain() -> bpy.types.Material:
    """Ribbed ribbon in cobalt blue with printed daisies, dots and a line along either edge."""
    paint = Paint("grosgrain")
    u, v, _ = paint.split(paint.attribute("chart"))
    rib = paint.formula("0.5 + 0.5 * cosine(u * 418.879)", u=u)  # 0.015 from rib to rib
    wear = paint.noise(paint.position(), 24.0, 3.0)
    fade = paint.noise(paint.position(), 2.6, 2.0)
    blue = paint.mix(paint.smooth(fade, 0.3, 0.7), (0.021, 0.075, 0.30), (0.035, 0.15, 0.44))
    cell = paint.math("FLOOR", paint.formula("u / 0.12", u=u))
    x = paint.formula("(fract(u / 0.12) - 0.5) * 0.12", u=u)
    radius = paint.formula("sqrt(x * x + v * v) + 0.004 * (w - 0.5)", x=x, v=v, w=wear)
    spin = paint.random(paint.join(cell, 0.0, 0.0))
    petal = paint.formula("0.034 * (0.5 + 0.5 * absolute(cosine(2.5 * (arctan2(v, x) + 6.28 * s))))", v=v, x=x, s=spin)
    daisy = paint.smooth(paint.math("SUBTRACT", petal, radius), -0.001, 0.002)
    heart = paint.smooth(radius, 0.009, 0.012, 1.0, 0.0)
    y = paint.formula("absolute(v) - 0.022", v=v)
    between = paint.formula("(fract(u / 0.12 + 0.5) - 0.5) * 0.12", u=u)
    dot = paint.smooth(paint.formula("sqrt(x * x + y * y)", x=between, y=y), 0.008, 0.011, 1.0, 0.0)
    line = paint.smooth(paint.formula("absolute(absolute(v) - 0.0475)", v=v), 0.0035, 0.005, 1.0, 0.0)
    cream, coral = (0.80, 0.72, 0.56), (0.66, 0.085, 0.045)
    colour = paint.mix(line, blue, cream)
    colour = paint.mix(dot, colour, coral)
    colour = paint.mix(daisy, colour, cream)
    colour = paint.mix(heart, colour, (0.78, 0.36, 0.03))
    print_ = paint.formula("maximum(maximum(line, dot), daisy)", line=line, dot=dot, daisy=daisy)
    shade = paint.formula("(0.72 + 0.28 * r) * (0.86 + 0.28 * w)", r=rib, w=wear)
    colour = paint.mix(shade, (0.02, 0.022, 0.05), colour)
    roughness = paint.formula(
        "0.42 + 0.20 * (1 - r) + 0.14 * p + 0.35 * (w - 0.4) + 0.15 * (f - 0.5)", r=rib, p=print_, w=wear, f=fade
    )
    return paint.finish(colour, paint.formula("minimum(0.9, maximum(0.3, r))", r=roughness))


def twill() -> bpy.types.Material:
    """Cotton binding with a slanted weave; the stitches of the far side are painted."""
    paint = Paint("twill")
    u, v, _ = paint.split(paint.attribute("chart"))
    weave = paint.formula("0.5 + 0.5 * cosine((u + v) * 330)", u=u, v=v)
    wear = paint.noise(paint.position(), 9.0, 4.0)
    colour = paint.mix(paint.smooth(wear, 0.3, 0.7), (0.022, 0.06, 0.22), (0.06, 0.14, 0.36))
    colour = paint.mix(paint.formula("0.3 * w", w=weave), colour, (0.03, 0.035, 0.09))
    dash = paint.formula(
        "a * b",
        a=paint.smooth(paint.formula("absolute(fract(u / 0.0641) - 0.5)", u=u), 0.20, 0.26, 1.0, 0.0),
        b=paint.smooth(paint.formula("absolute(v - 0.036)", v=v), 0.003, 0.005, 1.0, 0.0),
    )
    colour = paint.mix(dash, colour, (0.74, 0.66, 0.50))
    return paint.finish(colour, paint.formula("0.55 + 0.2 * k + 0.5 * (w - 0.4)", k=weave, w=wear))


def thread() -> bpy.types.Material:
    """Cream cotton thread."""
    paint = Paint("thread")
    tone = paint.noise(paint.position(), 20.0)
    return paint.finish(paint.mix(tone, (0.62, 0.52, 0.36), (0.84, 0.78, 0.64)), paint.formula("0.9 - 0.4 * t", t=tone))


def walnut() -> bpy.types.Material:
    """Waxed walnut turned from one billet: rings about a pith outside the axis, and pores along it."""
    paint = Paint("walnut")
    position = paint.position()
    x, y, z = paint.split(position)
    bend = paint.noise(position, 1.8, 2.0)
    ring = paint.formula(
        "fract(22 * sqrt(a * a + b * b) + 1.6 * n)",
        a=paint.formula("x + 0.16 + 0.12 * z", x=x, z=z),
        b=paint.math("SUBTRACT", y, 0.24),
        n=bend,
    )
    late = paint.formula("a * b", a=paint.smooth(ring, 0.1, 0.9), b=paint.smooth(ring, 0.92, 1.0, 1.0, 0.0))
    pores = paint.noise(paint.join(paint.formula("x * 12", x=x), paint.formula("y * 12", y=y), z), 7.0, 3.0)
    stain = paint.noise(position, 5.0, 4.0)
    colour = paint.mix(late, (0.36, 0.18, 0.078), (0.205, 0.094, 0.040))
    colour = paint.mix(paint.smooth(pores, 0.56, 0.70, 0.0, 0.6), colour, (0.075, 0.034, 0.021))
    colour = paint.mix(paint.smooth(stain, 0.45, 0.75, 0.0, 0.5), colour, (0.11, 0.048, 0.024))
    roughness = paint.formula(
        "0.28 + 0.14 * l + 0.45 * (s - 0.35) + p", l=late, s=stain, p=paint.smooth(pores, 0.5, 0.68, 0.0, 0.22)
    )
    return paint.finish(colour, paint.formula("minimum(0.85, maximum(0.2, r))", r=roughness))
