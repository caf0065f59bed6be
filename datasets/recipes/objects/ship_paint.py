"""Materials of the ship: planked, painted and varnished wood, sailcloth with emblems, rope, flags.

Every pattern is a function of Object coordinates; those that follow the hull take its keel and sheer line.
"""

from __future__ import annotations

import bpy

from .paint import Paint, Socket, Value

Palette = dict[str, bpy.types.Material]


def _affine(p: Paint, value: Value, scale: float, offset: float) -> Socket:
    return p.math("MULTIPLY_ADD", value, scale, offset)


def _stretched(p: Paint, x: float, y: float, z: float) -> Socket:
    return p.vector("MULTIPLY", p.position(), (x, y, z))


def _joint(p: Paint, value: Socket, half: float) -> Socket:
    """1 where `value` is within `half` of an integer, falling smoothly to 0."""
    distance = p.math("ABSOLUTE", p.math("SUBTRACT", p.math("FRACT", p.math("ADD", value, 0.5)), 0.5))
    return p.smooth(distance, 0.4 * half, half, 1.0, 0.0)


def _planks(p: Paint, along: Socket, across: Socket, length: float, seam: float) -> tuple[Socket, Socket]:
    """Random tone per plank and the mask of caulked seams; `across` counts planks, `along` is in scene units."""
    row = p.math("FLOOR", across)
    run = p.math("ADD", p.math("DIVIDE", along, length), p.math("MULTIPLY", row, 0.381))
    tone = p.random(p.join(row, p.math("FLOOR", run), 3.0))
    return tone, p.math("MAXIMUM", _joint(p, across, seam), _joint(p, run, 0.006 / length))


def timber(
    name: str, light: Value, dark: Value, gloss: float, dull: float, stretch: tuple[float, float, float]
) -> bpy.types.Material:
    """Wood with grain; `stretch` is the grain's frequency per axis, low along the fibres."""
    p = Paint(name)
    grain = p.smooth(p.noise(_stretched(p, *stretch), 1.0, 4.0), 0.36, 0.66)
    stain = p.smooth(p.noise(p.position(), 9.0, 2.0), 0.4, 0.65)
    shade = p.mix(p.math("MULTIPLY", stain, 0.45), p.mix(grain, light, dark), dark)
    wear = p.smooth(p.noise(p.position(), 17.0), 0.38, 0.62)
    return p.finish(shade, p.blend(p.blend(grain, 0.3, wear), gloss, dull))


def painted(name: str, color: Value, under: Value, gloss: float) -> bpy.types.Material:
    """Brushed paint, chipped down to `under` here and there, duller where it is worn."""
    p = Paint(name)
    cloud = p.smooth(p.noise(p.position(), 14.0), 0.35, 0.65)
    chip = p.smooth(p.noise(p.position(), 46.0, 4.0), 0.60, 0.64)
    faded = p.mix(p.math("MULTIPLY", cloud, 0.22), color, under)
    return p.finish(p.mix(p.math("MULTIPLY", chip, 0.8), faded, under),
                    p.blend(chip, p.blend(cloud, gloss, gloss + 0.16), 0.62))  # fmt: skip


def hull_paint(keel: float, sheer: tuple[float, float, float]) -> bpy.types.Material:
    """Red bottom, white waterline band, varnished oak topsides, blue bulwark with ochre lozenges.

    The planks fan out between the height `keel` and the main deck line z = a (x - b)**2 + c, `sheer` = (a, b, c).
    """
    a, b, c = sheer
    p = Paint("hull")
    x, y, z = p.split(p.position())
    off = p.math("ADD", x, -b)
    line = _affine(p, p.math("MULTIPLY", off, off), a, c)
    above = p.math("SUBTRACT", z, line)  # height over the main deck line
    fraction = p.math("DIVIDE", _affine(p, z, 1.0, -keel), _affine(p, line, 1.0, -keel))
    tone, seam = _planks(p, x, p.math("MULTIPLY", fraction, 13.0), 0.36, 0.09)
    grain = p.smooth(p.noise(_stretched(p, 9.0, 9.0, 90.0), 1.0, 4.0), 0.35, 0.65)
    oak = p.mix(tone, (0.36, 0.185, 0.07), (0.20, 0.088, 0.032))
    oak = p.mix(p.math("MULTIPLY", grain, 0.5), oak, (0.12, 0.05, 0.02))
    # painted bands
    lozenge = p.math("ADD", p.math("MULTIPLY", p.math("PINGPONG", x, 0.03), 1.0),
                     p.math("ABSOLUTE", _affine(p, above, 1.0, -0.037)))  # fmt: skip
    band = p.mix(p.smooth(lozenge, 0.020, 0.024), (0.62, 0.36, 0.05), (0.03, 0.085, 0.24))
    band = p.mix(p.between(above, 0.006, 0.068), (0.62, 0.36, 0.05), band)
    ornate = p.smooth(above, 0.0, 0.003)
    upper = p.between(above, 0.078, 0.5)
    band = p.mix(upper, band, p.mix(p.math("MULTIPLY", tone, 0.6), (0.22, 0.035, 0.03), (0.13, 0.02, 0.02)))
    bottom = p.mix(p.math("MULTIPLY", tone, 0.5), (0.34, 0.06, 0.035), (0.20, 0.035, 0.025))
    slime = p.smooth(p.math("ADD", z, p.math("MULTIPLY", p.noise(_stretched(p, 22.0, 22.0, 6.0), 1.0), 0.1)), -0.55, -0.46)
    bottom = p.mix(p.math("MULTIPLY", slime, 0.7), bottom, (0.07, 0.085, 0.04))
    under = p.smooth(z, -0.531, -0.527, 1.0, 0.0)
    boot = p.between(z, -0.529, -0.497, 0.002)
    color = p.mix(boot, p.mix(ornate, oak, band), (0.74, 0.71, 0.62))
    color = p.mix(under, color, bottom)
    paint = p.math("MAXIMUM", p.math("MAXIMUM", ornate, boot), under)
    # wear: chipped paint, run-off streaks, tarred seams
    chip = p.smooth(p.noise(_stretched(p, 30.0, 30.0, 55.0), 1.0, 4.0), 0.615, 0.65)
    streak = p.smooth(p.noise(_stretched(p, 38.0, 38.0, 4.0), 1.0), 0.52, 0.72)
    color = p.mix(p.math("MULTIPLY", p.math("MULTIPLY", chip, paint), 0.75), color, (0.30, 0.17, 0.08))
    color = p.mix(p.math("MULTIPLY", streak, 0.4), color, (0.10, 0.06, 0.035))
    color = p.mix(p.math("MULTIPLY", seam, p.blend(paint, 0.9, 0.55)), color, (0.03, 0.022, 0.02))
    rough = p.blend(paint, p.blend(grain, 0.42, 0.60), p.blend(slime, 0.28, 0.45))
    rough = p.blend(p.math("MAXIMUM", p.math("MULTIPLY", chip, paint), p.math("MULTIPLY", streak, 0.6)), rough, 0.72)
    return p.finish(color, p.blend(seam, rough, 0.8))


def deck_planking() -> bpy.types.Material:
    """Varnished pine planks with tarred seams, scrubbed dull along the walkways."""
    p = Paint("deck")
    x, y, _ = p.split(p.position())
    tone, seam = _planks(p, x, p.math("DIVIDE", y, 0.026), 0.24, 0.10)
    grain = p.smooth(p.noise(_stretched(p, 7.0, 110.0, 7.0), 1.0, 4.0), 0.35, 0.65)
    color = p.mix(tone, (0.60, 0.40, 0.19), (0.40, 0.24, 0.105))
    color = p.mix(p.math("MULTIPLY", grain, 0.4), color, (0.27, 0.15, 0.06))
    scrubbed = p.smooth(p.noise(p.position(), 8.0, 2.0), 0.46, 0.62)
    color = p.mix(p.math("MULTIPLY", scrubbed, 0.4), color, (0.62, 0.48, 0.30))
    rough = p.blend(scrubbed, p.blend(tone, 0.25, 0.33), 0.46)
    return p.finish(p.mix(p.math("MULTIPLY", seam, 0.9), color, (0.035, 0.028, 0.022)), p.blend(seam, rough, 0.7))


def canvas(name: str, emblem: str = "", centre: float = 0.0, radius: float = 0.1) -> bpy.types.Material:
    """Sailcloth in sewn vertical panels; `emblem` is '' or 'cross' or 'star', painted at height `centre` on y = 0."""
    p = Paint(name)
    x, y, z = p.split(p.position())
    panel = p.math("DIVIDE", y, 0.058)
    tone = p.random(p.join(p.math("FLOOR", panel), 1.0, 2.0))
    weave = p.smooth(p.noise(_stretched(p, 60.0, 60.0, 130.0), 1.0, 2.0), 0.35, 0.65)
    damp = p.smooth(p.noise(p.position(), 7.0, 4.0), 0.46, 0.68)
    cloth = p.mix(tone, (0.78, 0.70, 0.54), (0.66, 0.56, 0.40))
    cloth = p.mix(p.math("MULTIPLY", weave, 0.25), cloth, (0.50, 0.40, 0.27))
    cloth = p.mix(p.math("MULTIPLY", damp, 0.5), cloth, (0.44, 0.34, 0.22))
    reef = p.smooth(p.math("ABSOLUTE", _affine(p, z, 1.0, -centre - 1.25 * radius)), 0.004, 0.007, 1.0, 0.0)
    seam = p.math("MAXIMUM", _joint(p, panel, 0.07), reef)
    cloth = p.mix(p.math("MULTIPLY", seam, 0.6), cloth, (0.33, 0.24, 0.15))
    rough = p.blend(damp, p.blend(weave, 0.82, 0.93), 0.70)
    if emblem:
        mask, ink, second = _emblem(p, emblem, y, _affine(p, z, 1.0, -centre), radius)
        faded = p.math("MULTIPLY", mask, p.smooth(p.noise(p.position(), 34.0, 4.0), 0.34, 0.46, 0.55, 1.0))
        cloth = p.mix(faded, cloth, p.mix(second, ink, (0.66, 0.40, 0.06)))
        rough = p.blend(faded, rough, 0.5)
    return p.finish(cloth, rough)


def _emblem(p: Paint, kind: str, y: Socket, z: Socket, radius: float) -> tuple[Socket, Value, Socket]:
    """Mask of the painted area, its ink, and the mask of the second colour, ochre."""
    distance = p.vector("LENGTH", p.join(y, z, 0.0))
    rim = p.between(distance, 1.02 * radius, 1.14 * radius)
    if kind == "cross":
        a, b = p.math("ABSOLUTE", y), p.math("ABSOLUTE", z)
        arms = [p.smooth(p.math("SUBTRACT", one, _affine(p, other, 0.34, 0.13 * radius)), -0.003, 0.003, 1.0, 0.0)
                for one, other in ((a, b), (b, a))]  # fmt: skip
        inside = p.smooth(distance, 0.92 * radius, 0.96 * radius, 1.0, 0.0)
        return p.math("MAXIMUM", rim, p.math("MULTIPLY", inside, p.math("MAXIMUM", *arms))), (0.42, 0.025, 0.03), rim
    angle = p.math("ARCTAN2", z, y)
    reach = _affine(p, p.math("COSINE", p.math("MULTIPLY", angle, 8.0)), 0.27 * radius, 0.66 * radius)
    star = p.smooth(p.math("SUBTRACT", distance, reach), -0.003, 0.003, 1.0, 0.0)
    return p.math("MAXIMUM", rim, star), (0.035, 0.10, 0.30), p.smooth(distance, 0.3 * radius, 0.34 * radius, 1.0, 0.0)


def bunting(name: str, first: Value, second: Value) -> bpy.types.Material:
    """Striped flag cloth, faded toward the fly."""
    p = Paint(name)
    _, _, z = p.split(p.position())
    stripe = p.smooth(p.math("PINGPONG", z, 0.022), 0.009, 0.013)
    fade = p.smooth(p.noise(p.position(), 16.0), 0.4, 0.7, 0.0, 0.35)
    return p.finish(p.mix(fade, p.mix(stripe, first, second), (0.60, 0.52, 0.42)), p.blend(fade, 0.75, 0.92))


def palette(keel: float, sheer: tuple[float, float, float]) -> Palette:
    """All materials of the ship by the role they play; arguments as for `hull_paint`."""
    black = (0.035, 0.033, 0.034)
    return {
        "hull": hull_paint(keel, sheer),
        "deck": deck_planking(),
        "dark": timber("dark oak", (0.13, 0.062, 0.028), (0.045, 0.026, 0.020), 0.34, 0.58, (10.0, 40.0, 70.0)),
        "rail": timber("rail", (0.42, 0.20, 0.07), (0.20, 0.085, 0.03), 0.28, 0.50, (12.0, 60.0, 60.0)),
        "mast": timber("mast", (0.58, 0.36, 0.16), (0.30, 0.16, 0.065), 0.42, 0.68, (45.0, 45.0, 7.0)),
        "yard": timber("yard", (0.54, 0.33, 0.15), (0.28, 0.15, 0.06), 0.42, 0.68, (45.0, 8.0, 45.0)),
        "bowsprit": timber("bowsprit", (0.56, 0.34, 0.15), (0.29, 0.15, 0.06), 0.38, 0.62, (8.0, 45.0, 45.0)),
        "stand": timber("walnut", (0.20, 0.095, 0.042), (0.07, 0.034, 0.021), 0.20, 0.36, (9.0, 55.0, 55.0)),
        "raw": timber("raw wood", (0.62, 0.45, 0.26), (0.40, 0.26, 0.13), 0.58, 0.74, (14.0, 50.0, 50.0)),
        "red": painted("red paint", (0.46, 0.045, 0.03), (0.24, 0.12, 0.06), 0.28),
        "gold": painted("ochre paint", (0.72, 0.43, 0.06), (0.34, 0.17, 0.05), 0.24),
        "black": painted("black paint", black, (0.12, 0.075, 0.05), 0.30),
        "glass": painted("window panes", (0.045, 0.075, 0.085), (0.10, 0.13, 0.12), 0.16),
        "rope": timber("rope", (0.42, 0.32, 0.19), (0.20, 0.145, 0.085), 0.78, 0.92, (90.0, 90.0, 90.0)),
        "tarred": timber("tarred rope", (0.085, 0.065, 0.048), (0.04, 0.032, 0.026), 0.55, 0.80, (90.0, 90.0, 90.0)),
        "canvas": canvas("plain sail", centre=0.5, radius=0.1),
        "canvas_cross": canvas("main sail", "cross", 0.055, 0.115),
        "canvas_star": canvas("fore sail", "star", 0.02, 0.095),
        "flag": bunting("flag", (0.50, 0.03, 0.03), (0.80, 0.76, 0.66)),
        "pennant": bunting("pennant", (0.03, 0.10, 0.30), (0.78, 0.52, 0.08)),
    }
