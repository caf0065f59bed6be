"""What stands on the ship's decks and in her sides: balustrades, gratings, cabin, ladders, guns, barrels."""

from __future__ import annotations

import bpy  # noqa: F401  (mathutils can be imported only after bpy)
import numpy as np

# isort: split
from mathutils import Matrix

from .forms import box, lathe, sweep
from .ship_form import (
    FORECASTLE,
    POOP,
    QUARTER,
    SIDES,
    deck_height,
    half_breadth,
    rail_height,
    rectangle,
    sheer,
    side_path,
)
from .ship_paint import Palette


def build_fittings(m: Palette) -> None:
    """Balustrades, gratings, cabin, ladders, guns, barrels and the ship's boat."""
    for start, end, count in ((-0.735, POOP, 8), (POOP, QUARTER, 8), (FORECASTLE, 0.50, 8)):
        xs = np.linspace(start + 0.015, end - 0.015, count)
        for side in SIDES:
            feet = side_path(xs, rail_height, side, 0.006)
            _balustrade(m, feet)
    for brk in (POOP, QUARTER, FORECASTLE):
        x = brk - 0.006 if brk < 0 else brk + 0.006
        z = max(deck_height(brk - 0.01), deck_height(brk + 0.01))
        half = float(half_breadth(brk, z)) - 0.02
        _balustrade(m, np.array([(x, y, z + 0.010) for y in np.linspace(-half, half, 8)]))
    for x, y, length, width in ((0.095, 0.0, 0.13, 0.13), (-0.165, 0.0, 0.07, 0.11)):
        z = deck_height(x) + 0.012
        for sx, sy, dx, dy in (
            (1, 0, 0.014, width + 0.014),
            (-1, 0, 0.014, width + 0.014),
            (0, 1, length - 0.014, 0.014),
            (0, -1, length - 0.014, 0.014),
        ):
            box("coaming", (x + sx * length / 2, y + sy * width / 2, z), (dx, dy, 0.036), m["dark"])
        for k in range(1, 6):
            box("grating", (x, y + (k / 6 - 0.5) * width, z + 0.008), (length, 0.009, 0.010), m["raw"])
            box("grating", (x + (k / 6 - 0.5) * length, y, z + 0.011), (0.009, width, 0.010), m["raw"])
    _cabin(m, -0.345, 0.10, 0.15)
    for side in SIDES:
        for brk, run in ((QUARTER, 0.055), (FORECASTLE, -0.055)):
            low, high = deck_height(brk + run), deck_height(brk - 0.2 * run)
            for k in range(5):
                f = (k + 0.5) / 5
                box(
                    "tread",
                    (brk + run * (1.1 - f), side * 0.155, low + f * (high - low)),
                    (0.016, 0.052, 0.008),
                    m["rail"],
                )
            for dy in (-0.028, 0.028):
                ends = [(brk + 1.15 * run, side * 0.155 + dy, low), (brk + 0.1 * run, side * 0.155 + dy, high)]
                sweep("stringer", ends, rectangle(0.007, 0.022), m["dark"])
        for x in (-0.40, -0.26, -0.12, 0.02, 0.16, 0.30):
            _gun_port(m, x, side)
        for x in (-0.06, 0.19):
            _deck_gun(m, x, side)
    rng = np.random.default_rng(7)
    for x, y in ((-0.205, 0.10), (-0.205, 0.055), (0.23, -0.045), (0.235, 0.0), (-0.60, 0.05)):
        _barrel(m, x, y, float(rng.uniform(0.9, 1.1)))


def _balustrade(m: Palette, feet: np.ndarray) -> None:
    turned = [(0, -0.008), (0.0085, -0.008), (0.005, 0.008), (0.0105, 0.022), (0.0055, 0.046), (0, 0.046)]
    for foot in feet:
        lathe("baluster", turned, m["gold"], 5, foot, sharp_deg=70.0)
    sweep("hand rail", feet + (0, 0, 0.050), rectangle(0.020, 0.012), m["rail"])


def _cabin(m: Palette, x: float, length: float, width: float) -> None:
    """Deck house with glazed sides and an overhanging roof, on the quarterdeck."""
    z = deck_height(x) + 0.006
    box("cabin", (x, 0, z + 0.032), (length, width, 0.072), m["raw"])
    box("cabin roof", (x, 0, z + 0.072), (length + 0.026, width + 0.026, 0.014), m["red"], 0.004, segments=1)
    box("skylight", (x, 0, z + 0.084), (length * 0.5, width * 0.5, 0.020), m["glass"], 0.006, segments=1)
    for side in SIDES:
        for dx in (-0.025, 0.025):
            box("cabin frame", (x + dx, side * width / 2, z + 0.038), (0.038, 0.012, 0.036), m["gold"])
            box("cabin pane", (x + dx, side * width / 2, z + 0.038), (0.026, 0.016, 0.025), m["glass"])


def _gun_port(m: Palette, x: float, side: float) -> None:
    z = float(sheer(x)) - 0.092
    y = float(half_breadth(x, z))
    slope = float(half_breadth(x + 0.02, z) - half_breadth(x - 0.02, z)) / 0.04
    turn = Matrix.Rotation(side * np.arctan(slope), 3, "Z")
    box("port frame", (x, side * y, z), (0.062, 0.016, 0.058), m["dark"], turn=turn)
    box("port", (x, side * y, z), (0.044, 0.0185, 0.042), m["black"], turn=turn)
    box(
        "port lid",
        (x, side * (y + 0.030), z + 0.040),
        (0.052, 0.050, 0.010),
        m["red"],
        turn=turn @ Matrix.Rotation(side * 0.35, 3, "X"),
    )
    muzzle = [(0, 0), (0.0125, 0), (0.011, 0.046), (0.0145, 0.049), (0.0145, 0.058), (0.008, 0.058), (0, 0.046)]
    lathe("gun", muzzle, m["black"], 8, (x, side * y, z), (-slope * 0.5, side, 0.05))


def _deck_gun(m: Palette, x: float, side: float) -> None:
    z = deck_height(x)
    y = side * (float(half_breadth(x, z)) - 0.075)
    barrel = [
        (0, -0.050),
        (0.006, -0.046),
        (0.016, -0.036),
        (0.016, 0.0),
        (0.010, 0.052),
        (0.013, 0.060),
        (0.007, 0.062),
        (0, 0.05),
    ]
    lathe("deck gun", barrel, m["black"], 8, (x, y, z + 0.034), (0, side, 0.10))
    for dx in (-0.015, 0.015):
        box("carriage", (x + dx, y - side * 0.008, z + 0.023), (0.008, 0.068, 0.024), m["red"])
    for dy in (-0.026, 0.022):
        lathe(
            "truck",
            [(0, -0.027), (0.011, -0.027), (0.011, 0.027), (0, 0.027)],
            m["dark"],
            7,
            (x, y + dy - side * 0.006, z + 0.016),
            (1, 0, 0),
        )


def _barrel(m: Palette, x: float, y: float, size: float) -> None:
    z = deck_height(x) + 0.004
    profile = np.array([(0, 0), (0.019, 0), (0.0242, 0.018), (0.0242, 0.034), (0.019, 0.052), (0.016, 0.052), (0, 0.047)])
    lathe("barrel", profile * size, m["raw"], 9, (x, y, z))
    for h, r in ((0.012, 0.0235), (0.040, 0.0235)):
        hoop = np.array([(0, h - 0.003), (r, h - 0.003), (r, h + 0.003), (0, h + 0.003)])
        lathe("hoop", hoop * size, m["black"], 9, (x, y, z))
