"""Paints of the cloth bear: felt with a nap, corduroy, printed calico, satin, thread, buttons.

Prints use the mesh attribute 'chart' as lengths on the cloth; what is worn or dirty depends on the place on the bear.
"""

from __future__ import annotations

import bpy

from .craft import finish
from .paint import Paint, Socket

Colour = tuple[float, float, float]
TAU = 6.283185


def soiled(paint: Paint, colour: Socket) -> Socket:
    """`colour` with what years of play leave: grey dirt toward the seat, the feet and the paws, a few old stains."""
    p = paint.position()
    _, y, z = paint.split(p)
    cloud = paint.noise(p, 3.4, 5.0)
    low = paint.formula("1.5 * (c - 0.5) - 1.3 * minimum(z + 0.30, 0.9 * (y + 0.28))", z=z, y=y, c=cloud)
    grime = paint.smooth(low, 0.22, 0.75, 0.0, 0.55)
    colour = paint.mix(grime, colour, paint.vector("MULTIPLY", colour, (0.46, 0.43, 0.41)))
    stain = paint.noise(paint.vector("ADD", p, (4.0, 1.0, 2.0)), 2.1, 3.0)
    rim = paint.smooth(paint.formula("absolute(s - 0.66)", s=stain), 0.004, 0.016, 0.75, 0.0)
    spilt = paint.formula("maximum(r, 0.6 * s)", r=rim, s=paint.smooth(stain, 0.655, 0.67))
    return paint.mix(spilt, colour, paint.vector("MULTIPLY", colour, (0.58, 0.48, 0.38)))


def woven(paint: Paint, x: Socket, y: Socket, pitch: float) -> tuple[Socket, Socket]:
    """Plain weave of a cloth of coordinates (x, y): shade of the crossings and tone of the threads, both in [0, 1]."""
    a, b = paint.math("DIVIDE", x, pitch), paint.math("DIVIDE", y, pitch)
    over = paint.formula("sine(3.14159 * a) * sine(3.14159 * b)", a=a, b=b)
    rows = [
        paint.noise(paint.join(paint.formula("1.7 * floor(t)", t=t), paint.formula("4 * v", v=v), salt), 1.0, 2.0)
        for t, v, salt in ((a, y, 1.0), (b, x, 8.0))
    ]
    return paint.smooth(paint.math("ABSOLUTE", over), 0.0, 0.5), paint.blend(paint.math("GREATER_THAN", over, 0.0), *rows)


def cloth(paint: Paint, colour: Socket, fade: float = 0.30) -> bpy.types.Material:
    """Finish a print on calico: the weave's grain, bleaching in clouds, dirt; matt."""
    x, y, _ = paint.split(paint.attribute("chart"))
    shade, tone = woven(paint, x, y, 0.020)
    worn = paint.noise(paint.position(), 4.6, 4.0)
    colour = paint.mix(paint.smooth(worn, 0.42, 0.70, 0.0, fade), colour, (0.64, 0.58, 0.48))
    grain = paint.formula("(0.72 + 0.28 * s) * (0.66 + 0.68 * t)", s=shade, t=tone)
    colour = paint.mix(grain, paint.vector("MULTIPLY", colour, (0.30, 0.29, 0.30)), colour)
    rough = paint.formula("0.90 - 0.12 * s - 0.30 * (w - 0.5)", s=shade, w=worn)
    return finish(paint, soiled(paint, colour), rough, 0.70, 0.94)


def calico(name: str, ground: tuple[Colour, Colour], petals: tuple[Colour, Colour], scale: float) -> bpy.types.Material:
    """Small flowers of two colours with leaves on a dotted ground, `scale` flowers per unit of length."""
    paint = Paint(name)
    surface = paint.attribute("chart")
    cell = paint.voronoi(surface, scale, flat=True)
    x, y, _ = paint.split(paint.vector("SUBTRACT", surface, cell["Position"]))
    pick, turn, large = paint.split(cell["Color"])
    angle = paint.formula("t * k + arctan2(y, x)", t=turn, k=TAU, x=x, y=y)
    radius = paint.formula("d * s * (3.4 - 1.0 * l)", d=cell["Distance"], s=scale, l=large)
    strokes = paint.noise(surface, 34.0, 2.0)
    petal = paint.formula("0.55 + 0.42 * absolute(cosine(2.5 * a)) - r", a=angle, r=radius)
    sprig = paint.formula("1.55 * power(absolute(cosine(1.0 * a + 0.6)), 6) - r", a=angle, r=radius)
    colour = paint.mix(paint.smooth(paint.noise(surface, 5.0), 0.35, 0.65), *ground)
    seeds = paint.voronoi(paint.vector("ADD", surface, (3.3, 1.7, 0.0)), 2.4 * scale, flat=True)
    colour = paint.mix(paint.smooth(seeds["Distance"], 0.055 / scale, 0.10 / scale, 0.7, 0.0), colour, petals[1])
    colour = paint.mix(paint.smooth(sprig, -0.06, 0.06), colour, paint.mix(strokes, (0.05, 0.12, 0.05), (0.16, 0.24, 0.08)))
    bloom = paint.mix(paint.smooth(pick, 0.48, 0.52), *petals)
    bloom = paint.mix(paint.math("MULTIPLY", strokes, 0.5), bloom, ground[0])
    bloom = paint.mix(paint.smooth(radius, 0.20, 0.32), (0.74, 0.50, 0.10), bloom)
    return cloth(paint, paint.mix(paint.smooth(petal, -0.05, 0.05), colour, bloom))


def lines(paint: Paint, value: Socket, period: float, share: float) -> Socket:
    """Mask of stripes along `value` that fill `share` of every period."""
    off = paint.formula("absolute(fract(v / p) - 0.5)", v=value, p=period)
    return paint.smooth(off, 0.5 * share - 0.03, 0.5 * share + 0.03, 1.0, 0.0)


def ticking(name: str, pale: Colour, dark: Colour, thin: Colour, period: float) -> bpy.types.Material:
    """Striped mattress cloth: broad stripes with a thin one between."""
    paint = Paint(name)
    x, _, _ = paint.split(paint.attribute("chart"))
    colour = paint.mix(lines(paint, x, period, 0.42), pale, dark)
    between = lines(paint, paint.formula("v + 0.5 * p", v=x, p=period), period, 0.12)
    return cloth(paint, paint.mix(between, colour, thin), 0.22)


def gingham(name: str, pale: Colour, dark: Colour, period: float) -> bpy.types.Material:
    """Checked cloth: dark where stripes cross, half as dark where there is one."""
    paint = Paint(name)
    x, y, _ = paint.split(paint.attribute("chart"))
    both = paint.formula("0.5 * (a + b)", a=lines(paint, x, period, 0.5), b=lines(paint, y, period, 0.5))
    half = tuple(0.55 * p + 0.45 * d for p, d in zip(pale, dark, strict=True))
    colour = paint.mix(paint.smooth(both, 0.0, 0.5), pale, half)
    return cloth(paint, paint.mix(paint.smooth(both, 0.5, 1.0), colour, dark), 0.25)


def felt(name: str, light: Colour, dark: Colour, bald: Colour) -> bpy.types.Material:
    """Brushed wool: a nap that lies downward in tufts, rubbed through to `bald` ground cloth here and there."""
    paint = Paint(name)
    p = paint.position()
    bent = paint.vector("ADD", p, paint.vector("MULTIPLY", paint.join(paint.noise(p, 5.0), paint.noise(p, 6.0), 0.0), (0.10,) * 3))
    nap = paint.noise(paint.vector("MULTIPLY", bent, (46.0, 46.0, 17.0)), 1.0, 3.0)
    tufts, cloud = paint.noise(bent, 11.0, 3.0), paint.noise(p, 2.6, 3.0)
    tone = paint.formula("0.5 + 1.1 * (n - 0.5) + 0.9 * (t - 0.5) + 1.0 * (c - 0.5)", n=nap, t=tufts, c=cloud)
    colour = paint.mix(paint.smooth(tone, 0.12, 0.88), dark, light)
    flecks = paint.smooth(paint.noise(p, 62.0, 1.0), 0.67, 0.72, 0.0, 0.7)
    colour = paint.mix(flecks, colour, paint.vector("MULTIPLY", light, (1.35, 1.4, 1.5)))
    clouds = paint.noise(paint.vector("ADD", p, (9.0, 0.0, 0.0)), 3.2, 3.0)
    rubbed = paint.formula("c + 0.45 * (t - 0.5) + 0.25 * (n - 0.5)", c=clouds, t=tufts, n=nap)
    worn = paint.smooth(rubbed, 0.60, 0.70)
    x, y, z = paint.split(p)
    shade, _ = woven(paint, paint.formula("x + 0.4 * y", x=x, y=y), z, 0.022)
    bare = paint.mix(shade, paint.vector("MULTIPLY", bald, (0.6, 0.58, 0.55)), bald)
    rough = paint.formula("0.91 + 0.10 * (n - 0.5) - 0.13 * w - 0.12 * (c - 0.5)", n=nap, w=worn, c=cloud)
    return finish(paint, soiled(paint, paint.mix(worn, colour, bare)), rough, 0.72, 0.95)


def corduroy() -> bpy.types.Material:
    """Olive corduroy: chart.x counts the wales; dark furrows, ridges faded and thinned where the belly was rubbed."""
    paint = Paint("corduroy")
    wale, _, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    ridge = paint.formula("0.5 + 0.5 * cosine(w * k)", w=wale, k=TAU)
    cloud, fine = paint.noise(p, 3.0, 4.0), paint.noise(paint.vector("MULTIPLY", p, (30.0, 30.0, 16.0)), 1.0, 3.0)
    lane = paint.random(paint.join(paint.math("FLOOR", paint.math("ADD", wale, 0.5)), 2.0, 0.0))
    tone = paint.formula("0.5 + 0.5 * (l - 0.5) + 0.9 * (f - 0.5) + 0.9 * (c - 0.5)", l=lane, f=fine, c=cloud)
    colour = paint.mix(paint.smooth(tone, 0.1, 0.9), (0.075, 0.092, 0.038), (0.20, 0.205, 0.085))
    colour = paint.mix(paint.smooth(ridge, 0.0, 0.65, 0.75, 0.0), colour, (0.036, 0.042, 0.030))
    _, y, z = paint.split(p)
    belly = paint.smooth(paint.formula("absolute(z + 0.38)", z=z), 0.0, 0.32, 0.40, 0.0)
    belly = paint.formula("b * less_than(y, 0)", b=belly, y=y)
    rubbed = paint.formula("1.3 * (c - 0.5) + 0.6 * (f - 0.5) + b + 0.35 * (r - 0.5)", c=cloud, f=fine, b=belly, r=ridge)
    worn = paint.smooth(rubbed, 0.22, 0.48, 0.0, 0.85)
    colour = paint.mix(worn, colour, paint.mix(fine, (0.30, 0.27, 0.15), (0.44, 0.39, 0.25)))
    rough = paint.formula("0.90 - 0.10 * r - 0.10 * w + 0.14 * (f - 0.5)", r=ridge, w=worn, f=fine)
    return finish(paint, soiled(paint, colour), rough, 0.72, 0.95)


def satin() -> bpy.types.Material:
    """Crimson satin ribbon, chart (share of the length, -1 to 1 across): glossy, streaked along, frayed and dull at the edges."""
    paint = Paint("satin")
    along, across, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    streak = paint.noise(paint.join(paint.formula("3 * a", a=along), paint.formula("13 * v", v=across), 0.0), 1.0, 3.0)
    fade = paint.noise(p, 5.0, 4.0)
    tone = paint.formula("0.5 + 0.9 * (s - 0.5) + 1.2 * (f - 0.5)", s=streak, f=fade)
    colour = paint.mix(paint.smooth(tone, 0.15, 0.85), (0.25, 0.030, 0.036), (0.50, 0.075, 0.070))
    edge = paint.smooth(paint.math("ABSOLUTE", across), 0.80, 0.88)
    colour = paint.mix(paint.formula("0.85 * e", e=edge), colour, (0.62, 0.44, 0.16))
    crease = paint.smooth(paint.noise(paint.vector("MULTIPLY", p, (9.0, 9.0, 22.0)), 1.0, 3.0), 0.60, 0.68, 0.0, 0.6)
    colour = paint.mix(crease, colour, paint.vector("MULTIPLY", colour, (0.6, 0.6, 0.6)))
    rough = paint.formula("0.33 + 0.16 * (s - 0.5) + 0.45 * (f - 0.5) + 0.20 * e + 0.16 * c", s=streak, f=fade, e=edge, c=crease)
    return finish(paint, colour, rough, 0.26, 0.70)


def thread(name: str, light: Colour, dark: Colour) -> bpy.types.Material:
    """Sewing thread."""
    paint = Paint(name)
    tone = paint.noise(paint.position(), 26.0, 2.0)
    return finish(paint, paint.mix(paint.smooth(tone, 0.3, 0.7), dark, light), paint.formula("0.62 + 0.3 * t", t=tone), 0.6, 0.9)


def embroidery() -> bpy.types.Material:
    """Nose: black-brown silk laid in upright strands, chart (x, y, share of the profile)."""
    paint = Paint("embroidery")
    x, y, _ = paint.split(paint.attribute("chart"))
    strand = paint.formula("absolute(fract((x + 0.1 * y) / 0.019) - 0.5) * 2", x=x, y=y)
    tone = paint.noise(paint.join(paint.formula("floor(x / 0.019) * 1.3", x=x), paint.formula("9 * y", y=y), 0.0), 1.0, 2.0)
    colour = paint.mix(paint.smooth(strand, 0.2, 1.0), (0.075, 0.058, 0.050), (0.031, 0.030, 0.030))
    colour = paint.mix(paint.smooth(tone, 0.55, 0.75, 0.0, 0.6), colour, (0.12, 0.085, 0.065))
    return finish(paint, colour, paint.formula("0.42 + 0.22 * s + 0.3 * (t - 0.5)", s=strand, t=tone), 0.3, 0.75)


def button(name: str, light: Colour, dark: Colour, low: float, high: float) -> bpy.types.Material:
    """Polished buttons with fine dull scratches."""
    paint = Paint(name)
    p = paint.position()
    cloud = paint.noise(p, 14.0, 3.0)
    scratch = paint.smooth(paint.noise(paint.vector("MULTIPLY", p, (70.0, 20.0, 20.0)), 1.0, 1.0), 0.62, 0.70)
    rough = paint.formula("l + (h - l) * maximum(0.45 * c, s)", l=low, h=high, c=cloud, s=scratch)
    return finish(paint, paint.mix(paint.smooth(cloud, 0.3, 0.7), light, dark), rough, low, high)
