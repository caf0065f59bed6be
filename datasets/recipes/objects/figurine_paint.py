"""Paints of the porcelain figurine: glazes pooled in the folds, hand-painted flowers, gilding, bisque.

Patterns that follow the cloth use the mesh attribute 'chart': (along, up, fold), in units of length for the skirts.
"""

from __future__ import annotations

import bpy
import numpy as np

from .paint import Paint, Socket

GOLD = (0.62, 0.36, 0.06)
GLAZE = (0.84, 0.81, 0.75)
TAU = 2.0 * np.pi


def pooled(paint: Paint, low: float = 0.16, high: float = 0.30) -> Socket:
    """Roughness of glaze: smooth where it ran thick, duller where thin or rubbed."""
    position = paint.position()
    runs = paint.noise(paint.vector("MULTIPLY", position, (5.0, 5.0, 1.6)), 1.0, 2.0)
    rubbed = paint.smooth(paint.noise(position, 14.0, 4.0), 0.56, 0.72, 0.0, 0.07)
    return paint.math("ADD", paint.smooth(runs, 0.35, 0.65, low, high), rubbed)


def glazed(name: str, thin: tuple[float, float, float], thick: tuple[float, float, float]) -> bpy.types.Material:
    """Plain coloured glaze, drifting between two tints, with sparse iron specks."""
    paint = Paint(name)
    position = paint.position()
    tint = paint.mix(paint.smooth(paint.noise(position, 6.0), 0.35, 0.65), thin, thick)
    specks = paint.smooth(paint.voronoi(position, 14.0)["Distance"], 0.004, 0.007, 0.5, 0.0)
    return paint.finish(paint.mix(specks, tint, (0.16, 0.09, 0.05)), pooled(paint))


def gilt() -> bpy.types.Material:
    """Gold-yellow paint, rubbed through to the white glaze in places."""
    paint = Paint("gold paint")
    position = paint.position()
    worn = paint.smooth(paint.noise(position, 18.0), 0.57, 0.64)
    tone = paint.mix(paint.noise(position, 30.0), (0.46, 0.23, 0.03), (0.78, 0.48, 0.11))
    return paint.finish(paint.mix(worn, tone, GLAZE), paint.blend(worn, 0.40, 0.20))


def posy(paint: Paint, surface: Socket, scale: float, size: float, ground: Socket) -> Socket:
    """`ground` with one painted flower and its leaves per Voronoi cell of the flat coordinates `surface`."""
    cell = paint.voronoi(surface, scale, flat=True)
    x, y, _ = paint.split(paint.vector("SUBTRACT", surface, cell["Position"]))
    pick, turn, _ = paint.split(cell["Color"])
    angle = paint.math("MULTIPLY_ADD", turn, TAU, paint.math("ARCTAN2", y, x))
    lobes = paint.formula("absolute(cosine(2.5 * a))", a=angle)
    sprig = paint.formula("power(absolute(cosine(1.5 * a)), 5)", a=angle)
    radius = paint.math("DIVIDE", cell["Distance"], size)
    inside = paint.formula("0.62 + 0.40 * lobes - radius", lobes=lobes, radius=radius)
    leaves = paint.formula("2 * sprig - radius", sprig=sprig, radius=radius)
    strokes = paint.noise(surface, 60.0)
    green = paint.mix(strokes, (0.05, 0.16, 0.05), (0.24, 0.38, 0.09))
    hue = paint.mix(paint.smooth(pick, 0.33, 0.36), (0.66, 0.06, 0.12), (0.22, 0.14, 0.52))
    hue = paint.mix(paint.smooth(pick, 0.66, 0.69), hue, (0.80, 0.30, 0.10))
    pale = paint.mix(0.62, hue, (0.86, 0.74, 0.72))
    petal = paint.mix(paint.smooth(paint.math("ADD", radius, paint.math("MULTIPLY", strokes, 0.5)), 0.5, 1.1), hue, pale)
    petal = paint.mix(paint.smooth(radius, 0.20, 0.30), (0.80, 0.52, 0.06), petal)
    painted = paint.mix(paint.smooth(leaves, -0.06, 0.06), ground, green)
    return paint.mix(paint.smooth(inside, -0.06, 0.06), painted, petal)


def band(paint: Paint, value: Socket, centre: float, width: float) -> Socket:
    """Mask of a painted line of a given full width where `value` passes `centre`."""
    off = paint.formula("absolute(value - centre)", value=value, centre=centre)
    return paint.smooth(off, 0.40 * width, 0.60 * width, 1.0, 0.0)


def dots(paint: Paint, along: Socket, across: Socket, centre: float, spacing: float, radius: float) -> Socket:
    """Mask of a row of painted dots along the line where `across` is `centre`."""
    a = paint.formula("pingpong(v, half) - half / 2", v=along, half=spacing / 2)
    b = paint.math("SUBTRACT", across, centre)
    return paint.smooth(paint.vector("LENGTH", paint.join(a, b, 0.0)), 0.85 * radius, 1.15 * radius, 1.0, 0.0)


def either(paint: Paint, *masks: Socket) -> Socket:
    """Union of masks."""
    union = masks[0]
    for mask in masks[1:]:
        union = paint.math("MAXIMUM", union, mask)
    return union


def skirt_paint() -> bpy.types.Material:
    """Cream skirt strewn with flowers, a blue flounce and gold bands along the hem, pigment pooled in the troughs."""
    paint = Paint("skirt")
    along, up, fold = paint.split(paint.attribute("chart"))
    position = paint.position()
    drift = paint.noise(position, 5.0)
    ground = paint.mix(drift, (0.84, 0.78, 0.66), (0.80, 0.70, 0.62))
    ground = posy(paint, paint.join(along, up, 0.0), 6.0, 0.046, ground)
    edge = paint.formula("0.125 + 0.010 * sine(along * 62.8)", along=along)
    flounce = paint.smooth(paint.math("SUBTRACT", edge, up), -0.004, 0.004)
    blue = paint.mix(paint.smooth(paint.noise(position, 22.0), 0.3, 0.7), (0.10, 0.26, 0.50), (0.20, 0.42, 0.62))
    colour = paint.mix(flounce, ground, blue)
    above = paint.math("SUBTRACT", up, edge)
    worn = paint.smooth(paint.noise(position, 24.0), 0.58, 0.66, 1.0, 0.15)
    gold = either(
        paint,
        band(paint, above, 0.0, 0.012),
        band(paint, up, 0.012, 0.026),
        dots(paint, along, above, 0.024, 0.05, 0.009),
        dots(paint, along, up, 0.062, 0.10, 0.018),
    )
    gold = paint.math("MULTIPLY", gold, worn)
    colour = paint.mix(gold, colour, GOLD)
    trough = paint.math("MULTIPLY", paint.smooth(fold, -0.9, 0.0, 1.0, 0.0), paint.smooth(drift, 0.35, 0.6, 0.3, 0.8))
    colour = paint.mix(trough, colour, paint.vector("MULTIPLY", colour, (0.62, 0.58, 0.60)))
    glaze = paint.math("SUBTRACT", pooled(paint, 0.20, 0.32), paint.math("MULTIPLY", trough, 0.05))
    return paint.finish(colour, paint.blend(gold, paint.blend(flounce, glaze, 0.34), 0.42))


def brocade_paint() -> bpy.types.Material:
    """Rose-coloured overdress with gold sprigs, its edge a cream ruffle dotted in gold."""
    paint = Paint("brocade")
    along, up, fold = paint.split(paint.attribute("chart"))
    position = paint.position()
    rose = paint.mix(paint.smooth(paint.noise(position, 7.0), 0.3, 0.7), (0.56, 0.13, 0.19), (0.70, 0.25, 0.28))
    deep = paint.smooth(fold, -0.9, 0.3, 0.75, 0.0)
    rose = paint.mix(deep, rose, (0.36, 0.05, 0.10))
    sprig = paint.voronoi(position, 11.0)
    seeds = paint.smooth(paint.voronoi(paint.vector("ADD", position, (3.0, 1.0, 2.0)), 20.0)["Distance"], 0.006, 0.008, 1.0, 0.0)
    star = either(paint, seeds, paint.smooth(sprig["Distance"], 0.011, 0.014, 1.0, 0.0))
    ring = band(paint, sprig["Distance"], 0.019, 0.006)
    ruffle = paint.smooth(up, 0.060, 0.066, 1.0, 0.0)
    trim = either(
        paint,
        band(paint, up, 0.066, 0.016),
        band(paint, up, 0.004, 0.014),
        dots(paint, along, up, 0.034, 0.04, 0.008),
    )
    colour = paint.mix(either(paint, star, ring), rose, (0.80, 0.56, 0.20))
    colour = paint.mix(ruffle, colour, paint.mix(deep, GLAZE, (0.55, 0.50, 0.50)))
    colour = paint.mix(trim, colour, GOLD)
    glaze = paint.math("SUBTRACT", pooled(paint, 0.20, 0.34), paint.math("MULTIPLY", deep, 0.04))
    return paint.finish(colour, paint.blend(either(paint, star, trim), glaze, 0.42))


def lace_paint() -> bpy.types.Material:
    """White lace: rows of pierced dots drawn in grey, a gold edge where the chart's second coordinate ends."""
    paint = Paint("lace")
    along, up, _ = paint.split(paint.attribute("chart"))
    position = paint.position()
    holes = paint.smooth(paint.voronoi(position, 34.0)["Distance"], 0.006, 0.009, 0.65, 0.0)
    colour = paint.mix(holes, paint.mix(paint.noise(position, 9.0), GLAZE, (0.78, 0.72, 0.62)), (0.42, 0.44, 0.50))
    edge = paint.smooth(up, 0.86, 0.90)
    return paint.finish(paint.mix(edge, colour, GOLD), paint.blend(edge, paint.blend(holes, 0.38, 0.60), 0.42))


def bisque() -> bpy.types.Material:
    """Unglazed skin, blushed in clouds."""
    paint = Paint("bisque skin")
    position = paint.position()
    blush = paint.smooth(paint.noise(position, 9.0, 2.0), 0.45, 0.68, 0.0, 0.55)
    colour = paint.mix(blush, (0.80, 0.57, 0.45), (0.78, 0.40, 0.32))
    return paint.finish(colour, paint.smooth(paint.noise(position, 30.0, 4.0), 0.3, 0.7, 0.50, 0.68))


def bodice_paint() -> bpy.types.Material:
    """Blue bodice with a cream stomacher laced in gold."""
    paint = Paint("bodice")
    position = paint.position()
    x, y, z = paint.split(position)
    side = paint.math("ABSOLUTE", x)
    blue = paint.mix(paint.smooth(paint.noise(position, 12.0), 0.3, 0.7), (0.08, 0.22, 0.46), (0.18, 0.40, 0.60))
    width = paint.math("MULTIPLY_ADD", z, 0.18, -0.005)
    front = paint.math("LESS_THAN", y, 0.0)
    within = paint.math("SUBTRACT", width, side)
    panel = paint.math("MULTIPLY", paint.smooth(within, -0.002, 0.002), front)
    zigzag = paint.formula("pingpong(z + 0.9 * side, 0.022)", z=z, side=side)
    lacing = paint.math("MULTIPLY", paint.smooth(zigzag, 0.004, 0.007, 1.0, 0.0), panel)
    trim = paint.math("MULTIPLY", band(paint, within, 0.0, 0.014), front)
    sprigs = paint.smooth(paint.voronoi(position, 20.0)["Distance"], 0.008, 0.011, 1.0, 0.0)
    gold = either(paint, lacing, trim, paint.math("MULTIPLY", sprigs, paint.math("SUBTRACT", 1.0, panel)))
    gold = either(paint, gold, band(paint, z, 0.405, 0.022))
    return paint.finish(paint.mix(gold, paint.mix(panel, blue, GLAZE), GOLD), paint.blend(gold, pooled(paint), 0.42))


def oval(paint: Paint, x: Socket, z: Socket, centre: tuple[float, float], radii: tuple[float, float]) -> Socket:
    """Mask of a painted ellipse in the plane of the face."""
    a = paint.math("DIVIDE", paint.math("SUBTRACT", x, centre[0]), radii[0])
    b = paint.math("DIVIDE", paint.math("SUBTRACT", z, centre[1]), radii[1])
    return paint.smooth(paint.vector("LENGTH", paint.join(a, b, 0.0)), 0.85, 1.15, 1.0, 0.0)


def face_paint(centre: np.ndarray, turn: np.ndarray) -> bpy.types.Material:
    """Bisque face with painted eyes, brows, lips and blush; the head looks along -y of the axes `turn` (columns)."""
    paint = Paint("face")
    offset = paint.vector("SUBTRACT", paint.position(), tuple(centre))
    x, y, z = (paint.vector("DOT_PRODUCT", offset, tuple(axis)) for axis in turn.T)
    side = paint.math("ABSOLUTE", x)
    grain = paint.noise(offset, 40.0, 4.0)
    colour = paint.mix(grain, (0.82, 0.60, 0.48), (0.80, 0.55, 0.44))
    cheek = paint.vector("LENGTH", paint.join(paint.math("SUBTRACT", side, 0.052), 0.0, paint.math("ADD", z, 0.026)))
    front = paint.math("LESS_THAN", y, 0.0)
    colour = paint.mix(paint.math("MULTIPLY", paint.smooth(cheek, 0.0, 0.036, 0.75, 0.0), front), colour, (0.74, 0.22, 0.20))
    lid = oval(paint, side, z, (0.036, 0.0115), (0.0185, 0.0095))
    white = oval(paint, side, z, (0.036, 0.008), (0.0160, 0.0072))
    iris = paint.math("MULTIPLY", white, oval(paint, side, z, (0.035, 0.0095), (0.0075, 0.0080)))
    pupil = oval(paint, side, z, (0.035, 0.0095), (0.0036, 0.0040))
    arch = paint.formula("z + 9 * power(side - 0.036, 2)", z=z, side=side)
    brow = paint.math("MULTIPLY", band(paint, arch, 0.036, 0.006), band(paint, side, 0.037, 0.040))
    bow = paint.formula("z + 0.25 * absolute(side - 0.007)", z=z, side=side)
    lips = oval(paint, x, bow, (0.0, -0.054), (0.021, 0.0095))
    parting = paint.math("MULTIPLY", lips, band(paint, z, -0.055, 0.003))
    for mask, paint_colour in (
        (lid, (0.20, 0.08, 0.04)),
        (white, (0.84, 0.84, 0.82)),
        (iris, (0.08, 0.22, 0.42)),
        (pupil, (0.02, 0.02, 0.02)),
        (brow, (0.22, 0.10, 0.05)),
        (lips, (0.62, 0.08, 0.09)),
        (parting, (0.28, 0.03, 0.04)),
    ):
        colour = paint.mix(paint.math("MULTIPLY", mask, front), colour, paint_colour)
    drawn = either(paint, lid, white, lips)
    return paint.finish(colour, paint.blend(drawn, paint.smooth(grain, 0.3, 0.7, 0.52, 0.66), 0.32))


def hair_paint() -> bpy.types.Material:
    """Chestnut hair with brushed strands along the chart."""
    paint = Paint("hair")
    along, up, _ = paint.split(paint.attribute("chart"))
    strands = paint.noise(paint.join(paint.math("MULTIPLY", along, 60.0), paint.math("MULTIPLY", up, 4.0), 0.0), 1.0)
    colour = paint.mix(paint.smooth(strands, 0.3, 0.7), (0.12, 0.045, 0.022), (0.40, 0.19, 0.07))
    return paint.finish(colour, paint.smooth(strands, 0.3, 0.7, 0.32, 0.45))


def hat_paint() -> bpy.types.Material:
    """Straw hat: woven rings, a gold rim and a blue ribbon round the crown."""
    paint = Paint("hat")
    along, up, _ = paint.split(paint.attribute("chart"))
    position = paint.position()
    weave = paint.math("SINE", paint.math("MULTIPLY_ADD", paint.noise(position, 20.0), 3.0, paint.math("MULTIPLY", up, 190.0)))
    straw = paint.mix(paint.smooth(weave, -0.8, 0.8), (0.64, 0.46, 0.22), (0.80, 0.68, 0.42))
    ribbon = band(paint, up, 0.70, 0.12)
    colour = paint.mix(ribbon, straw, paint.mix(paint.noise(position, 25.0), (0.06, 0.16, 0.40), (0.16, 0.36, 0.60)))
    rim = band(paint, up, 0.40, 0.08)
    return paint.finish(paint.mix(rim, colour, GOLD), paint.blend(ribbon, paint.smooth(weave, -1.0, 1.0, 0.30, 0.45), 0.20))


def plume_paint() -> bpy.types.Material:
    """Feather, white at the quill and rose at the tip, with painted barbs."""
    paint = Paint("plume")
    along, up, _ = paint.split(paint.attribute("chart"))
    barbs = paint.math(
        "SINE", paint.math("MULTIPLY_ADD", paint.noise(paint.position(), 30.0), 4.0, paint.math("MULTIPLY", up, 150.0))
    )
    colour = paint.mix(paint.smooth(up, 0.2, 0.9), GLAZE, (0.70, 0.26, 0.30))
    colour = paint.mix(paint.smooth(barbs, 0.0, 1.0, 0.0, 0.5), colour, (0.40, 0.20, 0.22))
    return paint.finish(colour, paint.smooth(barbs, -1.0, 1.0, 0.28, 0.42))


def rose_paint(name: str, tone: tuple[float, float, float]) -> bpy.types.Material:
    """Modelled rose: pale petals with a painted spiral of dark edges, heart dark."""
    paint = Paint(name)
    along, up, _ = paint.split(paint.attribute("chart"))
    shade = paint.formula("up + 0.5 * noise", up=up, noise=paint.noise(paint.position(), 40.0))
    turns = paint.formula("pingpong(2 * along + 3.5 * up, 0.5)", along=along, up=up)
    dark = tuple(0.45 * channel for channel in tone)
    colour = paint.mix(paint.smooth(shade, 0.5, 1.3), paint.mix(0.45, tone, (0.85, 0.78, 0.74)), dark)
    colour = paint.mix(paint.smooth(turns, 0.02, 0.16, 0.75, 0.0), colour, dark)
    return paint.finish(colour, pooled(paint, 0.18, 0.34))


def fan_paint(pivot: np.ndarray) -> bpy.types.Material:
    """Painted fan opening from `pivot`: cream leaf with flowers, gold rim, brown sticks."""
    paint = Paint("fan")
    position = paint.position()
    offset = paint.vector("SUBTRACT", position, tuple(pivot))
    radius = paint.vector("LENGTH", offset)
    x, _, z = paint.split(position)
    leaf = posy(paint, paint.join(x, z, 0.0), 13.0, 0.020, paint.mix(paint.noise(position, 10.0), GLAZE, (0.62, 0.70, 0.76)))
    sticks = paint.smooth(radius, 0.112, 0.118, 1.0, 0.0)
    colour = paint.mix(sticks, leaf, paint.mix(paint.noise(position, 40.0), (0.20, 0.08, 0.03), (0.44, 0.22, 0.08)))
    rim = either(paint, band(paint, radius, 0.115, 0.010), paint.smooth(radius, 0.248, 0.253))
    return paint.finish(paint.mix(rim, colour, GOLD), paint.blend(rim, paint.blend(sticks, pooled(paint), 0.38), 0.42))


def base_paint() -> bpy.types.Material:
    """Base: mossy top, white glazed flank with gold lines, bare bisque underside bearing a blue workshop mark."""
    paint = Paint("base")
    position = paint.position()
    x, y, z = paint.split(position)
    along, up, _ = paint.split(paint.attribute("chart"))
    drift = paint.noise(position, 10.0, 5.0)
    moss = paint.mix(paint.smooth(drift, 0.35, 0.65), (0.12, 0.20, 0.05), (0.40, 0.44, 0.16))
    white = paint.mix(paint.smooth(drift, 0.4, 0.65), GLAZE, (0.64, 0.69, 0.70))
    flank = paint.join(paint.math("MULTIPLY", along, 3.6), paint.math("MULTIPLY", up, 0.35), 0.0)
    white = posy(paint, flank, 10.0, 0.022, white)
    top = paint.smooth(paint.math("ADD", up, paint.math("MULTIPLY", drift, 0.08)), 0.77, 0.79)
    bare = paint.smooth(up, 0.27, 0.28, 1.0, 0.0)
    clay = paint.mix(paint.noise(position, 45.0, 5.0), (0.76, 0.70, 0.60), (0.60, 0.52, 0.42))
    strokes = [band(paint, paint.math("ADD", x, paint.math("MULTIPLY", y, s)), 0.0, 0.025) for s in (0.6, -0.6)]
    close = paint.smooth(paint.vector("LENGTH", paint.join(x, y, 0.0)), 0.12, 0.13, 1.0, 0.0)
    clay = paint.mix(paint.math("MULTIPLY", either(paint, *strokes), close), clay, (0.05, 0.09, 0.36))
    gold = either(paint, band(paint, up, 0.44, 0.05), band(paint, up, 0.68, 0.06))
    colour = paint.mix(gold, paint.mix(top, white, moss), GOLD)
    roughness = paint.blend(gold, paint.blend(top, pooled(paint), paint.smooth(drift, 0.3, 0.7, 0.30, 0.55)), 0.42)
    grit = paint.smooth(paint.noise(position, 60.0), 0.3, 0.7, 0.55, 0.72)
    return paint.finish(paint.mix(bare, colour, clay), paint.blend(bare, roughness, grit))
