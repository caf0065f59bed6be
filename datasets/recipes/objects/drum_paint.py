"""Paints of the hand drum: carved wood with earth pigments, goat skin, rope, printed cloth, leather, shell.

Patterns that follow a surface use the mesh attribute 'chart'. Shell of the drum: turn and relief in [0, 1], 1 inside the foot.
Ropes and wrapped rings: fraction round the section, length along. Cowries: their own unit coordinates.
"""

from __future__ import annotations

import bpy

from .paint import Paint, Socket

FOOT_BAND, STEM_BAND, BOWL_BAND = (-0.83, -0.69), (-0.51, -0.385), (0.22, 0.36)
"""Heights between which the three painted bands lie."""

FOOT_MOTIFS, STEM_MOTIFS, BOWL_MOTIFS = 15, 10, 20
"""Repeats of a band's motif round the drum."""

COLLAR = (-0.245, -0.195)
"""Heights of the moulding under the bowl."""

OCHRE, EARTH, KAOLIN = (0.56, 0.27, 0.055), (0.26, 0.056, 0.035), (0.76, 0.71, 0.60)
SOOT, INDIGO = (0.041, 0.038, 0.036), (0.045, 0.085, 0.25)


# ---------------------------------------------------------------- the shell
def grain(paint: Paint) -> tuple[Socket, Socket, Socket]:
    """Colour and roughness of oiled hardwood carved from one log, and a stain that says where it was handled."""
    p = paint.position()
    x, y, z = paint.split(p)
    bend = paint.noise(p, 1.7, 2.0)
    ring = paint.formula(
        "fract(15 * sqrt((x - 0.11 - 0.08 * z) * (x - 0.11 - 0.08 * z) + (y + 0.07) * (y + 0.07)) + 1.9 * n)", x=x, y=y, z=z, n=bend
    )
    late = paint.formula("a * b", a=paint.smooth(ring, 0.15, 0.88), b=paint.smooth(ring, 0.90, 1.0, 1.0, 0.0))
    fibre = paint.noise(paint.join(paint.formula("x * 11", x=x), paint.formula("y * 11", y=y), z), 4.0, 4.0)
    pores = paint.noise(
        paint.join(paint.formula("x * 30", x=x), paint.formula("y * 30", y=y), paint.formula("z * 2", z=z)), 3.0, 2.0
    )
    stain = paint.noise(p, 3.4, 4.0)
    colour = paint.mix(paint.smooth(fibre, 0.30, 0.70), (0.47, 0.225, 0.090), (0.205, 0.082, 0.035))
    colour = paint.mix(paint.math("MULTIPLY", late, 0.9), colour, (0.137, 0.060, 0.033))
    colour = paint.mix(paint.smooth(pores, 0.60, 0.70, 0.0, 0.7), colour, (0.062, 0.036, 0.033))
    colour = paint.mix(paint.smooth(stain, 0.50, 0.75, 0.0, 0.65), colour, (0.092, 0.044, 0.033))
    roughness = paint.formula(
        "0.30 + 0.16 * l + 0.5 * (s - 0.4) + p", l=late, s=stain, p=paint.smooth(pores, 0.58, 0.70, 0.0, 0.22)
    )
    return colour, roughness, stain


def shell() -> bpy.types.Material:
    """Carved body: zigzags on the foot, lozenges on the stem, triangles on the bowl, dots on the collar; much is worn off."""
    paint = Paint("shell")
    p = paint.position()
    _, _, z = paint.split(p)
    turn, relief, inside = paint.split(paint.attribute("chart"))
    wood, wood_rough, stain = grain(paint)
    pigment, masks = wood, []
    for layer, mask in (_zigzags(paint, turn, z), _lozenges(paint, turn, z), _triangles(paint, turn, z), _dots(paint, turn, z)):
        pigment = paint.mix(mask, pigment, layer)
        masks.append(mask)
    painted = paint.formula("maximum(maximum(a, b), maximum(c, d))", **dict(zip("abcd", masks, strict=True)))
    strokes = paint.noise(paint.join(paint.formula("t * 30", t=turn), paint.formula("z * 90", z=z), 0.0), 1.0, 3.0)
    pigment = paint.mix(paint.smooth(strokes, 0.5, 0.8, 0.0, 0.35), pigment, wood)  # a dry brush
    scraped = paint.formula(
        "a + 0.16 * (r - 0.5) + 0.3 * (b - 0.5)", a=paint.noise(p, 4.5, 4.0), b=paint.noise(p, 28.0, 3.0), r=relief
    )
    kept = paint.math("MULTIPLY", painted, paint.smooth(scraped, 0.555, 0.60, 1.0, 0.0))
    colour = paint.mix(kept, wood, pigment)
    roughness = paint.blend(kept, wood_rough, paint.formula("0.66 + 0.4 * (n - 0.4)", n=strokes))

    groove = paint.smooth(relief, 0.06, 0.20, 1.0, 0.0)  # dirt that nobody wipes off
    colour = paint.mix(paint.math("MULTIPLY", groove, 0.85), colour, (0.056, 0.039, 0.034))
    dust = paint.smooth(paint.formula("z + 0.25 * (s - 0.5)", z=z, s=stain), -0.90, -0.72, 0.55, 0.0)
    colour = paint.mix(dust, colour, (0.46, 0.34, 0.23))
    colour = paint.mix(inside, colour, paint.mix(stain, (0.20, 0.12, 0.07), (0.09, 0.05, 0.036)))
    dull = paint.formula("maximum(maximum(g * 0.86, d * 1.4), i * 0.88)", g=groove, d=dust, i=inside)
    return paint.finish(colour, paint.formula("minimum(0.92, maximum(maximum(0.22, r), d))", r=roughness, d=dull))


def _across(paint: Paint, z: Socket, band: tuple[float, float]) -> tuple[Socket, Socket]:
    """Position across a band from 0 to 1, and the band's mask."""
    low, high = band
    return paint.formula("(z - low) / height", z=z, low=low, height=high - low), paint.between(z, low - 0.012, high + 0.012)


def _tooth(paint: Paint, turn: Socket, motifs: int, shift: float = 0.0) -> Socket:
    """Triangle wave from 1 to 0 to 1 over each motif."""
    return paint.formula(f"absolute(fract(t * {motifs} + {shift}) * 2 - 1)", t=turn)


def _zigzags(paint: Paint, turn: Socket, z: Socket) -> tuple[Socket, Socket]:
    """A raised white zigzag between indigo and ochre triangles, each with a dot, framed in black."""
    v, mask = _across(paint, z, FOOT_BAND)
    tooth = _tooth(paint, turn, FOOT_MOTIFS)
    off = paint.math("SUBTRACT", tooth, v)
    colour = paint.mix(paint.smooth(off, -0.02, 0.02), INDIGO, OCHRE)
    for shift, height, tint in ((0.5, 0.80, KAOLIN), (0.0, 0.20, SOOT)):
        across = paint.formula(f"(fract(t * {FOOT_MOTIFS} + {shift}) - 0.5) * 0.9", t=turn)
        dot = paint.vector("LENGTH", paint.join(across, paint.math("SUBTRACT", v, height), 0.0))
        colour = paint.mix(paint.smooth(dot, 0.085, 0.115, 1.0, 0.0), colour, tint)
    colour = paint.mix(paint.smooth(paint.math("ABSOLUTE", off), 0.17, 0.22, 1.0, 0.0), colour, KAOLIN)
    frame = paint.smooth(paint.formula("absolute(v - 0.5)", v=v), 0.50, 0.53)
    return paint.mix(frame, colour, SOOT), mask


def _lozenges(paint: Paint, turn: Socket, z: Socket) -> tuple[Socket, Socket]:
    """Concentric lozenges, ochre, black and white, on red earth."""
    v, mask = _across(paint, z, STEM_BAND)
    far = paint.formula("a + absolute(v * 2 - 1)", a=_tooth(paint, turn, STEM_MOTIFS), v=v)
    colour = paint.mix(paint.smooth(far, 0.26, 0.31), OCHRE, SOOT)
    colour = paint.mix(paint.smooth(far, 0.50, 0.55), colour, KAOLIN)
    colour = paint.mix(paint.smooth(far, 0.80, 0.85), colour, EARTH)
    speck = paint.formula("absolute(a - 1) + absolute(absolute(v * 2 - 1) - 0.72)", a=_tooth(paint, turn, STEM_MOTIFS), v=v)
    colour = paint.mix(paint.smooth(speck, 0.13, 0.17, 1.0, 0.0), colour, KAOLIN)
    return colour, mask


def _triangles(paint: Paint, turn: Socket, z: Socket) -> tuple[Socket, Socket]:
    """Two rows of teeth point to point, black above and indigo below, on white with an ochre line between."""
    v, mask = _across(paint, z, BOWL_BAND)
    tooth = _tooth(paint, turn, BOWL_MOTIFS)
    upper = paint.smooth(paint.formula("v - 0.52 - 0.42 * a", v=v, a=tooth), -0.02, 0.02)
    lower = paint.smooth(paint.formula("0.48 - 0.42 * a - v", v=v, a=tooth), -0.02, 0.02)
    colour = paint.mix(upper, KAOLIN, SOOT)
    colour = paint.mix(lower, colour, INDIGO)
    edge = paint.smooth(paint.formula("absolute(v - 0.5)", v=v), 0.44, 0.48)
    return paint.mix(edge, colour, OCHRE), mask


def _dots(paint: Paint, turn: Socket, z: Socket) -> tuple[Socket, Socket]:
    """White dots on the indigo moulding."""
    low, high = COLLAR
    across = paint.formula("(fract(t * 30) - 0.5) * 0.045", t=turn)
    dot = paint.vector("LENGTH", paint.join(across, paint.formula("z - middle", z=z, middle=0.5 * (low + high)), 0.0))
    return paint.mix(paint.smooth(dot, 0.010, 0.014, 1.0, 0.0), INDIGO, KAOLIN), paint.between(z, low, high)


# ---------------------------------------------------------------- skin, leather, shell
def goat_skin() -> bpy.types.Material:
    """Scraped skin: amber over the hollow and pale over the wood, a dark line of the spine, blots of pigment, polished edge."""
    paint = Paint("goat skin")
    p = paint.position()
    x, y, z = paint.split(p)
    far = paint.formula("sqrt(x * x + y * y)", x=x, y=y)
    cloud, fine = paint.noise(p, 3.2, 4.0), paint.noise(p, 17.0, 4.0)
    colour = paint.mix(paint.smooth(cloud, 0.30, 0.70), (0.72, 0.53, 0.31), (0.55, 0.345, 0.165))
    colour = paint.mix(paint.smooth(fine, 0.40, 0.75, 0.0, 0.5), colour, (0.44, 0.25, 0.11))
    thin = paint.smooth(paint.formula("r + 0.05 * (c - 0.5)", r=far, c=cloud), 0.455, 0.49)
    colour = paint.mix(paint.math("MULTIPLY", thin, 0.75), colour, (0.77, 0.66, 0.48))
    side = paint.formula("x - 0.05 + 0.10 * (c - 0.5) - 0.10 * sine(y * 3)", x=x, y=y, c=cloud)
    spine = paint.smooth(paint.formula("absolute(s) + 0.05 * (f - 0.5)", s=side, f=fine), 0.012, 0.060, 1.0, 0.0)
    colour = paint.mix(paint.math("MULTIPLY", spine, 0.92), colour, (0.135, 0.065, 0.038))
    flank = paint.formula("b + 0.55 * maximum(0, s) + 0.22 * (f - 0.5)", b=paint.noise(p, 2.1, 3.0), s=side, f=fine)
    blots = paint.smooth(flank, 0.575, 0.665)
    colour = paint.mix(paint.math("MULTIPLY", blots, 0.8), colour, (0.135, 0.075, 0.048))
    vein = paint.formula("absolute(n - 0.5)", n=paint.noise(paint.vector("MULTIPLY", p, (1.0, 0.45, 1.0)), 6.0, 1.0))
    colour = paint.mix(paint.smooth(vein, 0.004, 0.014, 0.4, 0.0), colour, (0.33, 0.15, 0.075))
    struck = paint.formula("absolute(r - 0.40 + 0.12 * (c - 0.5))", r=far, c=cloud)
    hands = paint.smooth(struck, 0.03, 0.11, 1.0, 0.0)
    colour = paint.mix(paint.math("MULTIPLY", hands, 0.25), colour, (0.36, 0.22, 0.12))
    cut = paint.smooth(z, 0.49, 0.51, 0.7, 0.0)
    colour = paint.mix(cut, colour, (0.80, 0.70, 0.52))
    roughness = paint.formula("0.58 - 0.20 * h + 0.40 * (f - 0.45) + 0.12 * b + 0.2 * c", h=hands, f=fine, b=blots, c=cut)
    return paint.finish(colour, paint.formula("minimum(0.85, maximum(0.3, r))", r=roughness))


def leather() -> bpy.types.Material:
    """Vegetable-tanned strap: chestnut, pale where it was bent, dark where it was gripped, soft gloss."""
    paint = Paint("leather")
    p = paint.position()
    broad, fine = paint.noise(p, 4.0, 3.0), paint.noise(p, 55.0, 3.0)
    crease = paint.voronoi(p, 26.0)["Distance"]
    colour = paint.mix(paint.smooth(broad, 0.30, 0.70), (0.127, 0.047, 0.034), (0.34, 0.135, 0.058))
    colour = paint.mix(paint.smooth(crease, 0.012, 0.030, 0.0, 0.45), colour, (0.080, 0.039, 0.034))
    scuffed = paint.smooth(paint.formula("b + 0.5 * (f - 0.5)", b=paint.noise(p, 9.0, 3.0), f=fine), 0.60, 0.68)
    colour = paint.mix(paint.math("MULTIPLY", scuffed, 0.7), colour, (0.47, 0.27, 0.14))
    roughness = paint.formula("0.30 + 0.35 * (f - 0.4) + 0.30 * s + 0.2 * (0.5 - b)", f=fine, s=scuffed, b=broad)
    return paint.finish(colour, paint.formula("minimum(0.75, maximum(0.24, r))", r=roughness))


def cowrie() -> bpy.types.Material:
    """Polished shell: ivory with a warm dome, a grey ring on its back, a dark toothed slit in its belly."""
    paint = Paint("cowrie")
    x, y, z = paint.split(paint.attribute("chart"))
    p = paint.position()
    tint = paint.noise(p, 20.0, 3.0)
    colour = paint.mix(paint.smooth(tint, 0.35, 0.70), (0.83, 0.77, 0.66), (0.71, 0.60, 0.43))
    dome = paint.formula("sqrt(x * x + y * y * 0.8)", x=x, y=y)
    back = paint.smooth(z, 0.1, 0.3)
    colour = paint.mix(paint.formula("b * s", b=back, s=paint.smooth(dome, 0.2, 0.75, 0.5, 0.0)), colour, (0.62, 0.50, 0.40))
    ring = paint.smooth(paint.formula("absolute(d - 0.55)", d=dome), 0.03, 0.09, 0.6, 0.0)
    colour = paint.mix(paint.math("MULTIPLY", back, ring), colour, (0.58, 0.38, 0.13))
    mouth = paint.formula("absolute(x - 0.06 * sine(y * 3)) - 0.05 * absolute(sine(y * 17))", x=x, y=y)
    slit = paint.formula("m * e", m=paint.smooth(mouth, 0.06, 0.13, 1.0, 0.0), e=paint.smooth(z, -0.2, 0.0, 1.0, 0.0))
    colour = paint.mix(slit, colour, (0.085, 0.050, 0.038))
    return paint.finish(colour, paint.formula("0.20 + 0.16 * t + 0.4 * s", t=tint, s=slit))


# ---------------------------------------------------------------- fibres
def rope(name: str, light: tuple[float, ...], dark: tuple[float, ...], mark: tuple[float, ...] | None = None) -> bpy.types.Material:
    """Rope laid of four strands, one of them of the colour `mark`: dark between them, soiled where hands and dust come."""
    paint = Paint(name)
    around, along, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    strand = paint.formula("absolute(fract(u * 4) * 2 - 1)", u=around)
    yarn = paint.noise(paint.join(paint.formula("u * 26", u=around), paint.formula("v * 22", v=along), 0.0), 1.0, 2.0)
    soiled = paint.noise(p, 6.0, 4.0)
    colour = paint.mix(paint.smooth(yarn, 0.32, 0.68), light, dark)
    if mark:
        fourth = paint.smooth(paint.formula("absolute(fract(u + 0.5) - 0.5)", u=around), 0.10, 0.14, 1.0, 0.0)
        colour = paint.mix(fourth, colour, mark)
    colour = paint.mix(paint.smooth(soiled, 0.48, 0.72, 0.0, 0.6), colour, tuple(0.45 * value + 0.02 for value in dark))
    shade = paint.smooth(strand, 0.0, 0.45, 0.7, 0.0)
    colour = paint.mix(shade, colour, tuple(max(0.034, 0.30 * value) for value in dark))
    return paint.finish(colour, paint.formula("0.70 + 0.35 * (y - 0.5) + 0.18 * s", y=yarn, s=shade))


def wrapping(name: str, ground: tuple[float, ...], figure: tuple[float, ...], spot: tuple[float, ...]) -> bpy.types.Material:
    """Strip of printed cotton wound round a ring: seams of the winding, a stripe along the strip, printed spots, faded."""
    paint = Paint(name)
    around, along, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    phase = paint.formula("v / 0.095 + u", v=along, u=around)
    turn, across = paint.math("FLOOR", phase), paint.math("FRACT", phase)
    weave = paint.formula("0.5 + 0.25 * sine(u * 150) + 0.25 * sine(v * 700)", u=around, v=along)
    fade = paint.noise(p, 5.0, 3.0)
    lot = paint.random(paint.join(turn, 3.0, 0.0))
    base = paint.mix(paint.smooth(fade, 0.35, 0.70, 0.0, 0.55), ground, tuple(0.5 * value + 0.22 for value in ground))
    stripe = paint.smooth(paint.formula("absolute(a - 0.5)", a=across), 0.10, 0.14, 1.0, 0.0)
    colour = paint.mix(paint.formula("s * greater_than(l, 0.25)", s=stripe, l=lot), base, figure)
    x = paint.formula("(fract(u * 4 + l) - 0.5) * 0.9", u=around, l=lot)
    y = paint.formula("absolute(a - 0.5) - 0.30", a=across)
    dot = paint.smooth(paint.vector("LENGTH", paint.join(x, paint.math("MULTIPLY", y, 2.2), 0.0)), 0.19, 0.24, 1.0, 0.0)
    colour = paint.mix(dot, colour, spot)
    seam = paint.smooth(paint.formula("minimum(a, 1 - a)", a=across), 0.0, 0.07, 0.75, 0.0)
    colour = paint.mix(seam, colour, (0.046, 0.035, 0.034))
    worn = paint.smooth(paint.noise(p, 13.0, 4.0), 0.60, 0.70, 0.0, 0.5)
    colour = paint.mix(worn, colour, (0.50, 0.44, 0.36))
    return paint.finish(colour, paint.formula("0.80 + 0.16 * (w - 0.5) - 0.25 * (f - 0.5) - 0.1 * k", w=weave, f=fade, k=worn))


def thread() -> bpy.types.Material:
    """Waxed linen thread."""
    paint = Paint("thread")
    tone = paint.noise(paint.position(), 26.0, 3.0)
    colour = paint.mix(paint.smooth(tone, 0.3, 0.7), (0.78, 0.70, 0.52), (0.58, 0.46, 0.27))
    return paint.finish(colour, paint.formula("0.55 + 0.3 * (t - 0.5)", t=tone))


def wound_yarn() -> bpy.types.Material:
    """Heads of the beaters: red wool wound in a spiral, two cream threads toward the stick, flattened where they strike."""
    paint = Paint("wool")
    around, along, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    off = paint.formula("absolute(fract(v * 8 + u) - 0.5)", v=along, u=around)
    fluff = paint.noise(p, 40.0, 3.0)
    colour = paint.mix(paint.smooth(paint.noise(p, 9.0, 3.0), 0.35, 0.65), (0.50, 0.085, 0.045), (0.30, 0.040, 0.035))
    cream = paint.formula("a * b", a=paint.between(along, 0.62, 0.82), b=paint.smooth(off, 0.12, 0.20, 1.0, 0.0))
    colour = paint.mix(cream, colour, (0.72, 0.60, 0.38))
    colour = paint.mix(paint.smooth(off, 0.36, 0.5, 0.0, 0.65), colour, (0.10, 0.034, 0.034))
    struck = paint.smooth(paint.noise(p, 14.0, 3.0), 0.58, 0.68, 0.0, 0.6)
    colour = paint.mix(struck, colour, (0.44, 0.27, 0.18))
    return paint.finish(colour, paint.formula("0.88 + 0.2 * (f - 0.6) - 0.25 * s", f=fluff, s=struck))


def turned_wood() -> bpy.types.Material:
    """Pale wood of the beaters and the toggle, dark from hands."""
    paint = Paint("turned wood")
    p = paint.position()
    streak = paint.noise(paint.vector("MULTIPLY", p, (6.0, 6.0, 18.0)), 4.0, 3.0)
    held = paint.noise(p, 3.0, 3.0)
    colour = paint.mix(paint.smooth(streak, 0.35, 0.68), (0.62, 0.41, 0.205), (0.40, 0.22, 0.09))
    colour = paint.mix(paint.smooth(held, 0.45, 0.70, 0.0, 0.6), colour, (0.17, 0.085, 0.042))
    return paint.finish(colour, paint.formula("0.36 + 0.4 * (s - 0.4) - 0.25 * (h - 0.5)", s=streak, h=held))
