"""A white game console, standing, with its controller leaning against it.

White things under a coloured light: whether the plastic or the lamp is yellow can be told only from the few saturated
accents, the highlights and one's expectations. The console stands along z, its front looks to -y, and the controller
leans against its glossy +x side.
"""

from __future__ import annotations

import math

import bpy

# isort: split
from mathutils import Matrix, Vector  # can be imported only after bpy

from . import console_paint as paint
from .console_controller import build_controller
from .forms import frame
from .parts import Parts, apply_modifiers, cut_out, loft, rounded_rectangle, slab, turned

HALF = (0.285, 0.50, 0.715)  # half extents of the console's box along x, y, z
CENTRE = Vector((-0.195, 0.0, 0.018))
CORNER, EDGE = 0.09, 0.042  # radii of the corners seen from the side, and of the edges around the two sides
FOOT = 0.035
SIDE = CENTRE.x + HALF[0]  # the plane that the controller leans against
FLOOR = CENTRE.z - HALF[2] - FOOT


def _recess(cutters: Parts, at: Matrix, half_u: float, half_v: float, radius: float, depth: float, steps: int = 3) -> None:
    """Add a cutter with dark (slot 1) floor and walls and a chamfered rim of the shell's colour (slot 0)."""
    part = slab(half_u, half_v, radius, [(0.0, -depth), (0.0, -0.005), (0.012, 0.007)], steps)
    count = (len(part[1]) - 2) // 2
    cutters.add(part, [1] * count + [0] * count + [1, 0], at)


def _on(side: str, u: float, v: float) -> Matrix:
    """Frame on a face of the console: z outward; x and y of the frame along (u, v) in the face."""
    axis, sign = {"left": (0, -1), "right": (0, 1), "front": (1, -1), "back": (1, 1), "bottom": (2, -1), "top": (2, 1)}[side]
    normal = Vector([sign * (k == axis) for k in range(3)])
    up = (0, 1, 0) if side in ("top", "bottom") else (0, 0, 1)
    matrix = frame(CENTRE + normal * HALF[axis], normal, up)
    return matrix @ Matrix.Translation((u, v, 0.0))


def _housing(materials: list[bpy.types.Material]) -> None:
    """White box, coloured band and glossy side plate, parted by gaps, with every opening cut in.

    ``materials``: shell, insides, band, side plate.
    """
    hx, hy, hz = HALF
    stations: list[tuple[float, float, int]] = []  # x, inset of the section, material of the strip that follows
    for step in range(5):
        turn = math.pi / 8 * step
        stations.append((-hx + EDGE * (1 - math.cos(turn)), EDGE * (1 - math.sin(turn)), 0))
    for x, before, after in ((0.105, 0, 2), (0.155, 2, 3)):
        lip = 0.006
        stations += [(x - lip - 0.005, 0.0, before), (x - 0.005, lip, before), (x - 0.005, 0.024, 1)]
        stations += [(x + 0.005, 0.024, 1), (x + 0.005, lip, after), (x + lip + 0.005, 0.0, after)]
    for step in range(5):
        turn = math.pi / 8 * (4 - step)
        stations.append((hx - EDGE * (1 - math.cos(turn)), EDGE * (1 - math.sin(turn)), 3))
    rings = [[(x, y, z) for y, z in rounded_rectangle(hy - inset, hz - inset, CORNER - inset, 6)] for x, inset, _ in stations]
    vertices, faces = loft(rings)
    count = len(rings[0])
    slots = [slot for _, _, slot in stations[:-1] for _ in range(count)]
    body = Parts(materials)
    body.add((vertices, faces), [*slots, 0, 3], Matrix.Translation(CENTRE))
    box = body.link("console_housing")

    cutters = Parts(materials[:2])
    for column in range(5):
        for row in range(11 + column % 2):
            spot = _on("top", -0.075 + 0.066 * (column - 2), 0.066 * (row - (5.5 if column % 2 else 5.0)))
            _recess(cutters, spot, 0.0225, 0.0225, 0.0225, 0.05)
    for slot in range(8):  # vents of the left side
        _recess(cutters, _on("left", 0.0, -0.56 + 0.054 * slot), 0.35, 0.012, 0.012, 0.045)
    for slot in range(9):  # vents of the back
        _recess(cutters, _on("back", 0.085, 0.17 + 0.052 * slot), 0.13, 0.011, 0.011, 0.045)
    _recess(cutters, _on("front", 0.0, 0.05), 0.012, 0.44, 0.012, 0.07)  # the disc goes in here
    _recess(cutters, _on("front", -0.145, 0.41), 0.045, 0.045, 0.045, 0.02, 5)  # power button
    _recess(cutters, _on("front", -0.145, 0.29), 0.022, 0.022, 0.022, 0.02)  # eject button
    for v in (-0.24, -0.45):
        _recess(cutters, _on("front", -0.145, v), 0.018, 0.045, 0.004, 0.05, 1)
    ports = ((-0.30, 0.05, 0.020, 0.006), (-0.40, 0.03, 0.030, 0.004), (-0.51, 0.045, 0.028, 0.027))
    for v, half_u, half_v, radius in ports:
        _recess(cutters, _on("back", 0.145, v), half_u, half_v, radius, 0.05, 2)
    for v in (-0.32, -0.40):
        _recess(cutters, _on("back", 0.03, v), 0.022, 0.022, 0.020, 0.04)
    for slot in range(4):
        _recess(cutters, _on("bottom", 0.085 + 0.05 * (slot - 1.5), 0.0), 0.010, 0.17, 0.010, 0.03)
    cut_out(box, cutters, "console_cutters")
    box.data.shade_smooth()
    box.data.set_sharp_from_angle(angle=math.radians(30.0))
    weights = box.modifiers.new("flat faces stay flat", "WEIGHTED_NORMAL")
    weights.keep_sharp, weights.weight = True, 80
    apply_modifiers(box)


def _fittings(
    light: bpy.types.Material,
    inside: bpy.types.Material,
    rubber: bpy.types.Material,
    accents: list[bpy.types.Material],
) -> None:
    """Buttons, tongues of the ports, feet, label and sticker of the console; ``accents`` are red, yellow and teal."""
    label_at, sticker_at = _on("back", 0.08, -0.01), _on("left", 0.19, 0.34)
    parts = Parts([light, inside, rubber, *accents, paint.label(label_at, (0.13, 0.085)), paint.sticker(sticker_at, 0.19)])
    button = [(0.041, -0.02), (0.041, 0.002), (0.038, 0.006), (0.028, 0.008), (0.010, 0.005)]
    parts.add(turned(button, 20, start_cap=False), 0, _on("front", -0.145, 0.41))
    eject = [(0.018, -0.02), (0.018, 0.001), (0.015, 0.004)]
    parts.add(turned(eject, 14, start_cap=False), 3, _on("front", -0.145, 0.29))
    for v in (-0.24, -0.45):
        tongue = slab(0.006, 0.036, 0.002, [(0.0, -0.049), (0.0, -0.008)], 1, False)
        parts.add(tongue, 5, _on("front", -0.145, v))
    parts.add(slab(0.034, 0.005, 0.002, [(0.0, -0.049), (0.0, -0.01)], 1, False), 0, _on("back", 0.145, -0.30))
    for v, slot in ((-0.32, 3), (-0.40, 4)):
        plug = [(0.014, -0.039), (0.014, -0.004), (0.007, -0.004), (0.007, -0.03)]
        parts.add(turned(plug, 12, start_cap=False), slot, _on("back", 0.03, v))
    for u in (-0.19, 0.19):
        for v in (-0.35, 0.35):
            foot = [(0.060, -0.002), (0.056, 0.028), (0.050, FOOT), (0.030, FOOT), (0.026, FOOT - 0.006)]
            parts.add(turned(foot, 18, start_cap=False), 2, _on("bottom", u, v))
    parts.add(slab(0.13, 0.085, 0.012, [(0.0, -0.002), (0.0, 0.003)], 3, False), 6, label_at)
    parts.add(turned([(0.19, -0.002), (0.19, 0.003)], 40, start_cap=False), 7, sticker_at)
    jewel = [(0.024, -0.002), (0.024, 0.006), (0.020, 0.011), (0.010, 0.014)]
    for place, slot in enumerate((3, 4, 5)):
        parts.add(turned(jewel, 16, start_cap=False), slot, _on("right", -0.36 + 0.065 * place, 0.57))
    parts.link("console_fittings")


def build() -> None:
    """Build the console and its controller in the current scene."""
    light = paint.plain("console_light_grey", paint.GREY, (0.40, 0.30))
    inside = paint.dark("console_inside", paint.INK, (0.55, 0.80))
    rubber = paint.dark("console_rubber", (0.035, 0.035, 0.037), (0.65, 0.85))
    red, yellow, green, blue, teal = (
        paint.plain(f"console_{name}", colour, (0.30, 0.45))
        for name, colour in (
            ("red", paint.RED),
            ("yellow", paint.YELLOW),
            ("green", paint.GREEN),
            ("blue", paint.BLUE),
            ("teal", paint.TEAL),
        )
    )
    _housing([paint.shell(CENTRE, HALF), inside, teal, paint.gloss(CENTRE, HALF)])
    _fittings(light, inside, rubber, [red, yellow, teal])
    build_controller(light, inside, [red, yellow, green, blue], SIDE, FLOOR)
