"""Paints of the bowl of fruit: peels, russet, bloom on grapes, turned wood, linen.

A fruit's mesh attribute 'chart' is the point on the fruit before it was scaled, turned and placed: z along its axis, the
stem at positive z, about 1 from the middle to the flank. A leaf's is (along, across, 0) from 0 to 1 and -1 to 1.
"""

from __future__ import annotations

import bpy

from .craft import finish
from .paint import Paint, Socket

Colour = tuple[float, float, float]


def streaks(paint: Paint, chart: Socket, count: float, seed: float) -> Socket:
    """Noise drawn out from stem to eye, about `count` streaks round a fruit."""
    x, y, z = paint.split(chart)
    across = paint.formula("sqrt(x * x + y * y) + 0.001", x=x, y=y)
    ring = paint.join(
        paint.formula("x / a * k + s", x=x, a=across, k=count / 6.0, s=seed),
        paint.formula("y / a * k", y=y, a=across, k=count / 6.0),
        paint.formula("z * 0.7", z=z),
    )
    return paint.noise(ring, 1.0, 4.0)


def apple(name: str, ground: tuple[Colour, Colour], blush: tuple[Colour, Colour], red: float, seed: float) -> bpy.types.Material:
    """Waxy peel: two tints of `ground`, a cheek streaked with two of `blush`, lenticels, russet round the stem, a bruise.

    `red` is the share of the peel that the blush covers, about.
    """
    paint = Paint(name)
    chart = paint.attribute("chart")
    x, y, z = paint.split(chart)
    moved = paint.vector("ADD", chart, (seed, 2.0 * seed, 0.0))
    cloudy, fine = paint.noise(moved, 1.6), paint.noise(moved, 9.0)
    thin, broad = streaks(paint, chart, 90.0, seed), streaks(paint, chart, 26.0, seed + 3.0)
    base = paint.mix(paint.smooth(cloudy, 0.35, 0.65), *ground)
    base = paint.mix(paint.smooth(z, 0.0, 0.75, 0.0, 0.45), base, ground[0])
    cheek = paint.formula("0.55 * x + 0.30 * y + 0.35 * z + 1.1 * (c - 0.5)", x=x, y=y, z=z, c=cloudy)
    cover = paint.formula("c + 1.5 * (b - 0.5) + 1.9 * (t - 0.5) + r", c=cheek, b=broad, t=thin, r=2.0 * red - 1.0)
    tone = paint.mix(paint.smooth(thin, 0.35, 0.65), *blush)
    colour = paint.mix(paint.smooth(cover, -0.18, 0.55), base, tone)
    spots = paint.voronoi(moved, 5.5)
    size = paint.formula("0.012 + 0.020 * c", c=paint.split(spots["Color"])[0])
    lenticels = paint.smooth(paint.math("SUBTRACT", spots["Distance"], size), -0.010, 0.014, 0.75, 0.0)
    colour = paint.mix(lenticels, colour, paint.mix(0.6, ground[1], (0.66, 0.52, 0.30)))
    radius = paint.formula("sqrt(x * x + y * y)", x=x, y=y)
    dimple = paint.formula("r + 0.9 * (f - 0.5) + 0.5 * (b - 0.5)", r=radius, f=fine, b=broad)
    top = paint.math("GREATER_THAN", z, 0.0)
    russet = paint.math("MULTIPLY", paint.smooth(dimple, 0.16, 0.42, 1.0, 0.0), top)
    colour = paint.mix(russet, colour, paint.mix(fine, (0.30, 0.24, 0.07), (0.42, 0.26, 0.11)))
    eye = paint.math("MULTIPLY", paint.smooth(radius, 0.07, 0.20, 1.0, 0.0), paint.math("SUBTRACT", 1.0, top))
    colour = paint.mix(eye, colour, (0.09, 0.06, 0.04))
    mark = paint.smooth(paint.noise(paint.vector("ADD", moved, (7.0, 0.0, 3.0)), 1.3, 4.0), 0.66, 0.70, 0.0, 0.85)
    colour = paint.mix(mark, colour, paint.mix(fine, (0.20, 0.10, 0.045), (0.34, 0.19, 0.08)))
    matt = paint.smooth(paint.noise(moved, 2.7, 3.0), 0.45, 0.65)
    gloss = paint.formula("0.27 + 0.20 * m + 0.10 * l + 0.25 * (f - 0.5)", m=matt, l=lenticels, f=fine)
    rough = paint.formula("g + 0.30 * r + 0.25 * e + 0.22 * b", g=gloss, r=russet, e=eye, b=mark)
    return finish(paint, colour, rough, 0.2, 0.85)


def citrus(name: str, light: Colour, dark: Colour, unripe: Colour, pores: float) -> bpy.types.Material:
    """Pitted peel: `light` to `dark` in clouds, `unripe` toward the stem, `pores` dimples across the fruit's radius."""
    paint = Paint(name)
    chart = paint.attribute("chart")
    x, y, z = paint.split(chart)
    cloudy, fine = paint.noise(chart, 1.7, 3.0), paint.noise(chart, 11.0, 3.0)
    pit = paint.voronoi(chart, pores)
    sunk = paint.smooth(paint.math("MULTIPLY", pit["Distance"], pores), 0.10, 0.42, 1.0, 0.0)
    colour = paint.mix(paint.smooth(cloudy, 0.32, 0.68), light, dark)
    colour = paint.mix(paint.math("MULTIPLY", paint.split(pit["Color"])[1], 0.35), colour, light)
    green = paint.formula("0.8 * z + 2.2 * (c - 0.5)", z=z, c=paint.noise(chart, 1.1, 4.0))
    colour = paint.mix(paint.smooth(green, 0.62, 1.15, 0.0, 0.8), colour, unripe)
    colour = paint.mix(paint.math("MULTIPLY", sunk, 0.5), colour, paint.vector("MULTIPLY", colour, (0.55, 0.45, 0.5)))
    scar = paint.smooth(paint.noise(paint.vector("MULTIPLY", chart, (1.0, 1.0, 0.35)), 4.2, 4.0), 0.68, 0.72, 0.0, 0.8)
    colour = paint.mix(scar, colour, paint.mix(fine, (0.30, 0.17, 0.06), (0.48, 0.32, 0.15)))
    radius = paint.formula("sqrt(x * x + y * y) + 0.2 * (f - 0.5)", x=x, y=y, f=fine)
    tip = paint.smooth(radius, 0.07, 0.17, 0.9, 0.0)
    colour = paint.mix(tip, colour, paint.mix(paint.smooth(z, -0.1, 0.1), (0.20, 0.11, 0.05), (0.16, 0.19, 0.07)))
    rough = paint.formula(
        "0.36 + 0.16 * s + 0.5 * (c - 0.5) + 0.25 * (f - 0.5) + 0.28 * k + 0.2 * t", s=sunk, c=cloudy, f=fine, k=scar, t=tip
    )
    return finish(paint, colour, rough, 0.22, 0.85)


def pear() -> bpy.types.Material:
    """Yellow-green skin with a cheek, brown lenticels, and a net of russet that closes toward the stem and the eye."""
    paint = Paint("pear")
    chart = paint.attribute("chart")
    x, y, z = paint.split(chart)
    cloudy, fine = paint.noise(chart, 1.5), paint.noise(chart, 12.0)
    colour = paint.mix(paint.smooth(cloudy, 0.35, 0.65), (0.38, 0.40, 0.07), (0.62, 0.50, 0.12))
    cheek = paint.formula("0.8 * y - 0.3 * x + 1.3 * (c - 0.5)", x=x, y=y, c=paint.noise(chart, 2.4, 4.0))
    colour = paint.mix(paint.smooth(cheek, 0.25, 0.95, 0.0, 0.8), colour, (0.46, 0.11, 0.04))
    spots = paint.voronoi(chart, 6.5)
    colour = paint.mix(paint.smooth(spots["Distance"], 0.018, 0.034, 0.8, 0.0), colour, (0.22, 0.13, 0.05))
    ends = paint.formula("maximum(z - 0.75, 0 - z - 0.45)", z=z)
    net = paint.formula("absolute(n - 0.5) * 2", n=paint.noise(chart, 4.6, 4.0))
    spread = paint.formula("0.75 * e - 1.1 * n + 0.9 * (c - 0.45)", e=ends, n=net, c=cloudy)
    russet = paint.smooth(spread, -0.12, 0.12)
    colour = paint.mix(russet, colour, paint.mix(fine, (0.26, 0.14, 0.05), (0.44, 0.27, 0.11)))
    eye = paint.math("MULTIPLY", paint.smooth(paint.formula("sqrt(x * x + y * y)", x=x, y=y), 0.10, 0.24, 1.0, 0.0),
                     paint.math("LESS_THAN", z, 0.0))  # fmt: skip
    colour = paint.mix(eye, colour, (0.07, 0.05, 0.035))
    rough = paint.formula("0.38 + 0.36 * r + 0.5 * (c - 0.5) + 0.25 * (f - 0.5)", r=russet, c=cloudy, f=fine)
    return finish(paint, colour, rough, 0.26, 0.85)


def grape() -> bpy.types.Material:
    """Blue-black skin, glossy where it was touched, under a matt bloom; chart: (height along its axis, hash, 0)."""
    paint = Paint("grape")
    height, chance, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    skin = paint.mix(chance, (0.034, 0.030, 0.042), (0.062, 0.031, 0.046))
    patches, fine = paint.noise(p, 13.0, 3.0), paint.noise(p, 55.0, 3.0)
    cover = paint.formula("1.5 * (p - 0.5) + 0.8 * (f - 0.5) + 0.5 * (h - 0.4) + 0.10 * z", p=patches, f=fine, h=chance, z=height)
    bloom = paint.smooth(cover, -0.16, 0.22)
    colour = paint.mix(paint.math("MULTIPLY", bloom, 0.8), skin, (0.075, 0.082, 0.130))
    scar = paint.smooth(paint.formula("z + 0.06 * (f - 0.5)", z=height, f=fine), 0.965, 0.985)
    colour = paint.mix(scar, colour, (0.20, 0.13, 0.06))
    ripe = paint.smooth(paint.math("ABSOLUTE", paint.math("ADD", height, 1.0)), 0.01, 0.03, 0.8, 0.0)
    colour = paint.mix(ripe, colour, (0.12, 0.08, 0.05))
    rough = paint.formula("0.20 + 0.46 * b + 0.12 * (f - 0.5) + 0.2 * s", b=bloom, f=fine, s=scar)
    return finish(paint, colour, rough, 0.17, 0.78)


def stem() -> bpy.types.Material:
    """Woody stems, brown with green stretches and pale lichen."""
    paint = Paint("stem")
    p = paint.position()
    tone = paint.noise(p, 9.0)
    colour = paint.mix(paint.smooth(tone, 0.4, 0.6), (0.15, 0.085, 0.04), (0.24, 0.20, 0.07))
    colour = paint.mix(paint.smooth(paint.noise(p, 40.0), 0.58, 0.66, 0.0, 0.7), colour, (0.42, 0.34, 0.20))
    return paint.finish(colour, paint.formula("0.62 + 0.3 * t", t=tone))


def leaf(name: str, green: tuple[Colour, Colour], autumn: tuple[Colour, Colour], age: float) -> bpy.types.Material:
    """Leaf with veins, a duller underside's tint in its thickness, spots and rims turning to `autumn` with `age`."""
    paint = Paint(name)
    along, across, _ = paint.split(paint.attribute("chart"))
    p = paint.position()
    off = paint.math("ABSOLUTE", across)
    cloudy, fine = paint.noise(p, 7.0, 4.0), paint.noise(p, 40.0, 3.0)
    colour = paint.mix(paint.smooth(cloudy, 0.35, 0.65), *green)
    slant = paint.formula("absolute(fract(a * 7.5 - 2.2 * o) - 0.5)", a=along, o=off)
    veins = paint.formula("maximum(m, s)", m=paint.smooth(off, 0.05, 0.10, 1.0, 0.0), s=paint.smooth(slant, 0.41, 0.47))
    turned = paint.formula("1.1 * (c - 0.5) + 0.8 * (f - 0.5) + 0.5 * o + g - 0.45", c=cloudy, f=fine, o=off, g=age)
    dry = paint.smooth(turned, -0.05, 0.22)
    colour = paint.mix(dry, colour, paint.mix(fine, *autumn))
    colour = paint.mix(paint.math("MULTIPLY", veins, 0.65), colour, paint.mix(dry, (0.34, 0.40, 0.14), (0.30, 0.17, 0.06)))
    holes = paint.smooth(paint.noise(p, 16.0, 2.0), 0.70, 0.73, 0.0, 0.9)
    colour = paint.mix(holes, colour, (0.10, 0.055, 0.032))
    rough = paint.formula("0.42 + 0.22 * d + 0.14 * v + 0.3 * (c - 0.5) + 0.2 * h", d=dry, v=veins, c=cloudy, h=holes)
    return finish(paint, colour, rough, 0.28, 0.85)


def wood(table: float) -> bpy.types.Material:
    """Side-grain elm under old lacquer: rings about a pith above the bowl, rays and pores, worn at rim, bead and foot."""
    paint = Paint("turned wood")
    p = paint.position()
    x, y, z = paint.split(p)
    bend, fine = paint.noise(p, 1.5, 3.0), paint.noise(p, 26.0, 4.0)
    up = paint.formula("z - t", z=z, t=table)
    far = paint.formula(
        "sqrt(a * a + b * b)", a=paint.formula("y - 0.13 + 0.10 * x", x=x, y=y), b=paint.formula("u - 1.12 + 0.06 * x", u=up, x=x)
    )
    years = paint.formula("12 * d + 2.6 * n + 0.9 * sine(5 * d)", d=far, n=bend)
    ring, year = paint.math("FRACT", years), paint.random(paint.join(paint.math("FLOOR", years), 3.0, 1.0))
    late = paint.formula("a * b * (0.65 + 0.35 * y)", a=paint.smooth(ring, 0.15, 0.92),
                         b=paint.smooth(ring, 0.93, 1.0, 1.0, 0.0), y=year)  # fmt: skip
    fibre = paint.noise(paint.vector("MULTIPLY", p, (3.0, 30.0, 30.0)), 1.0, 4.0)
    pores = paint.smooth(paint.noise(paint.vector("MULTIPLY", p, (9.0, 60.0, 60.0)), 1.0, 2.0), 0.58, 0.68)
    early = paint.smooth(ring, 0.05, 0.35, 1.0, 0.25)
    bare = paint.mix(paint.smooth(fibre, 0.3, 0.7), (0.42, 0.25, 0.12), (0.58, 0.38, 0.205))
    bare = paint.mix(late, bare, (0.135, 0.062, 0.030))
    bare = paint.mix(paint.formula("0.6 * p * e", p=pores, e=early), bare, (0.13, 0.065, 0.032))
    stain = paint.noise(p, 3.1, 4.0)
    amber = paint.vector("MULTIPLY", bare, (0.72, 0.50, 0.34))
    colour = paint.mix(paint.smooth(stain, 0.35, 0.7, 0.0, 0.5), amber, paint.vector("MULTIPLY", amber, (0.62, 0.55, 0.55)))
    exposed = paint.formula(
        "maximum(maximum(a, b), c)",
        a=paint.smooth(up, 0.515, 0.572, 0.0, 0.36),
        b=paint.smooth(up, 0.0, 0.06, 0.36, 0.0),
        c=paint.smooth(paint.formula("absolute(u - 0.336)", u=up), 0.004, 0.030, 0.25, 0.0),
    )
    rub = paint.formula("e + 1.3 * (s - 0.5) + 0.9 * (f - 0.5)", e=exposed, s=paint.noise(p, 4.4, 4.0), f=fine)
    worn = paint.smooth(rub, 0.20, 0.32)
    colour = paint.mix(worn, colour, bare)
    burnt = paint.formula(
        "maximum(a, b)",
        a=paint.smooth(paint.formula("absolute(u - 0.393)", u=up), 0.005, 0.012, 0.8, 0.0),
        b=paint.smooth(paint.formula("absolute(u - 0.051)", u=up), 0.008, 0.016, 0.7, 0.0),
    )
    colour = paint.mix(burnt, colour, (0.055, 0.036, 0.030))
    scratch = paint.smooth(paint.noise(paint.vector("MULTIPLY", p, (50.0, 7.0, 11.0)), 1.0, 1.0), 0.69, 0.72, 0.0, 0.55)
    colour = paint.mix(scratch, colour, paint.vector("MULTIPLY", bare, (1.25, 1.2, 1.15)))
    gloss = paint.formula("0.22 + 0.30 * (s - 0.35) + 0.10 * p + 0.18 * h", s=stain, p=pores, h=scratch)
    rough = paint.formula("g + 0.20 * b + 0.05 * l", g=paint.blend(worn, gloss, 0.66), b=burnt, l=late)
    return finish(paint, colour, rough, 0.18, 0.85)


def linen(half: float, hem: float) -> bpy.types.Material:
    """Plain weave of uneven threads, a madder and an indigo border, a mitred hem; creases, wine and wear.

    The weave follows x and y; `half` is half the cloth's width, `hem` the hem's.
    """
    paint = Paint("linen")
    p = paint.position()
    x, y, _ = paint.split(p)
    pitch = 0.028
    warp, weft = (paint.formula("c / w", c=c, w=pitch) for c in (x, y))
    over = paint.formula("sine(3.14159 * a) * sine(3.14159 * b)", a=warp, b=weft)  # above zero where the warp is on top
    on_top = paint.smooth(over, -0.25, 0.25)
    tones = []
    for thread, along, salt in ((warp, y, 1.0), (weft, x, 2.0)):
        number = paint.math("FLOOR", thread)
        slub = paint.noise(paint.join(paint.formula("n * 1.7", n=number), paint.formula("v * 5", v=along), salt), 1.0, 2.0)
        tones.append(paint.formula("0.55 * r + 0.9 * (s - 0.5) + 0.22", r=paint.random(paint.join(number, salt, 0.0)), s=slub))
    tone = paint.blend(on_top, tones[1], tones[0])
    colour = paint.mix(paint.smooth(tone, 0.05, 0.95), (0.30, 0.235, 0.155), (0.68, 0.60, 0.455))
    inward_x, inward_y = (paint.formula("h - absolute(c)", h=half, c=c) for c in (x, y))

    def border(inward: Socket, start: float, end: float) -> Socket:
        middle, wide = 0.5 * (start + end), 0.5 * (end - start)
        return paint.smooth(paint.formula("absolute(i - m)", i=inward, m=middle), wide - 0.004, wide + 0.004, 1.0, 0.0)

    for start, end, dye in ((0.105, 0.165, (0.36, 0.055, 0.045)), (0.185, 0.205, (0.055, 0.075, 0.20)),
                            (0.066, 0.086, (0.055, 0.075, 0.20))):  # fmt: skip
        dyed = paint.blend(on_top, border(inward_y, start, end), border(inward_x, start, end))
        pale, deep = (paint.vector("MULTIPLY", dye, (share,) * 3) for share in (1.4, 0.62))
        colour = paint.mix(paint.math("MULTIPLY", dyed, 0.86), colour, paint.mix(tone, deep, pale))
    gap = paint.smooth(paint.formula("absolute(o)", o=over), 0.0, 0.20, 0.55, 0.0)
    colour = paint.mix(gap, colour, paint.vector("MULTIPLY", colour, (0.55, 0.52, 0.48)))
    mitre = paint.smooth(paint.formula("absolute(a - b)", a=inward_x, b=inward_y), 0.004, 0.009, 1.0, 0.0)
    corner = paint.formula("less_than(maximum(a, b), h)", a=inward_x, b=inward_y, h=hem)
    edge = paint.smooth(paint.formula("absolute(minimum(a, b) - h)", a=inward_x, b=inward_y, h=hem), 0.003, 0.009, 0.55, 0.0)
    colour = paint.mix(paint.formula("maximum(0.7 * m * c, e)", m=mitre, c=corner, e=edge), colour, (0.16, 0.12, 0.085))
    cloud = paint.noise(p, 2.2, 4.0)
    colour = paint.mix(paint.smooth(cloud, 0.42, 0.72, 0.0, 0.55), colour, paint.vector("MULTIPLY", colour, (0.66, 0.58, 0.46)))
    rim = paint.formula("sqrt(a * a + b * b) + 0.10 * (n - 0.5)", a=paint.formula("x - 0.36", x=x),
                        b=paint.formula("y + 0.30", y=y), n=paint.noise(p, 6.0, 4.0))  # fmt: skip
    wine = paint.formula("maximum(a, b)", a=paint.smooth(rim, 0.10, 0.118, 0.50, 0.0),
                         b=paint.smooth(paint.formula("absolute(r - 0.110)", r=rim), 0.004, 0.014, 0.85, 0.0))  # fmt: skip
    colour = paint.mix(wine, colour, (0.20, 0.045, 0.055))
    rough = paint.formula("0.88 - 0.10 * w - 0.16 * (t - 0.5) - 0.25 * (c - 0.5)", w=wine, t=tone, c=cloud)
    return finish(paint, colour, rough, 0.68, 0.95)


def thread() -> bpy.types.Material:
    """Bleached linen thread."""
    paint = Paint("linen thread")
    tone = paint.noise(paint.position(), 22.0)
    return paint.finish(paint.mix(tone, (0.60, 0.54, 0.42), (0.80, 0.76, 0.66)), paint.formula("0.70 + 0.3 * t", t=tone))
