"""A wooden galleon model on a display cradle: planked and painted hull, fitted decks, three rigged masts with sails.

The bow points along +x. The hull is one analytic surface (`ship_form.half_breadth`), from which skin, decks, wales,
railings, cradle and rigging feet take their points, so that parts meet wherever they are placed.
"""

from __future__ import annotations

import bpy  # noqa: F401  (mathutils can be imported only after bpy)
import numpy as np

# isort: split
from mathutils import Matrix

from .forms import box, lathe, plate, sheet, sweep, tube_along_curve
from .ship_fittings import build_fittings
from .ship_form import (
    FORECASTLE,
    KEEL,
    POOP,
    QUARTER,
    SHEER,
    SHEER_X,
    SHEER_Z,
    SIDES,
    bow_x,
    deck_height,
    half_breadth,
    rail_height,
    rectangle,
    sheer,
    side_path,
    stations,
    stern_x,
)
from .ship_paint import Palette, palette
from .ship_rig import build_masts_and_sails, build_rigging

# ---------------------------------------------------------------- hull
REGIONS = ((-0.752, POOP), (POOP, QUARTER), (QUARTER, FORECASTLE), (FORECASTLE, 0.572))


def build_hull(m: Palette) -> None:
    """Outer skin, transom, inner bulwarks, decks with their bulkheads, wales, keel, stem and rudder."""
    edge = 0.002
    xs = np.concatenate([np.linspace(a + edge, b - edge, n) for (a, b), n in zip(REGIONS, (6, 6, 10, 16), strict=True)])
    rails = np.array([rail_height(x) for x in xs])
    # the stations' rake follows a rail line without steps: following the steps would fold the skin at the breaks
    smooth_rail = sheer(xs) + np.interp(xs, [-0.62, -0.37, 0.0, 0.42], [0.189, 0.114, 0.07, 0.104])
    u = (xs - stern_x(smooth_rail)) / (bow_x(smooth_rail) - stern_x(smooth_rail))
    u[0], u[-1] = 0.0, 1.0
    levels = np.linspace(0.0, 1.0, 13) ** 0.9
    z = KEEL + levels * (rails[:, None] - KEEL)
    x = stern_x(z) + u[:, None] * (bow_x(z) - stern_x(z))
    y = half_breadth(x, z)
    port, starboard = np.stack([x, y, z], -1), np.stack([x, -y, z], -1)
    sheet("hull skin", np.concatenate([starboard[:, ::-1], port[:, 1:]], axis=1), m["hull"])
    first = int(np.argmax(y[0] > 0.01)) - 1  # its lower tip, narrower than the sternpost, hides behind that
    transom = np.repeat(port[0, first:, None], 7, axis=1)
    transom[..., 1] = np.maximum(y[0, first:, None], 0.004) * np.linspace(1.0, -1.0, 7)
    sheet("transom", transom, m["hull"])
    for (start, end), count in zip(REGIONS, (5, 5, 8, 12), strict=True):
        end = min(end, 0.555)
        run = stations(start + 0.004, end - 0.004, count)
        rail, deck = (np.array([f(v) for v in run]) for f in (rail_height, deck_height))
        width = half_breadth(run, deck) - 0.010
        rows = [np.stack([run, width * s, deck + 0.008 * (1.0 - s * s)], -1) for s in np.linspace(1.0, -1.0, 7)]
        sheet("deck", np.stack(rows, 1), m["deck"])
        for side in SIDES:
            inner = [np.stack([run, side * (half_breadth(run, h) - 0.013), h], -1) for h in (deck - 0.004, rail)]
            sheet("inner bulwark", np.stack(inner if side < 0 else inner[::-1], 1), m["red"])
            cap = side_path(stations(max(start, -0.765), min(end, 0.552), count + 3), rail_height, side, 0.005)
            cap[:, 2] = np.interp(cap[:, 0], run, rail) + 0.004
            sweep("cap rail", cap, rectangle(0.030, 0.013), m["rail"])
    for drop, size in ((-0.004, 0.020), (-0.040, 0.014), (-0.150, 0.024)):
        for side in SIDES:
            aft = float(stern_x(sheer(-0.71) + drop)) + 0.004
            path = side_path(stations(aft, 0.56, 24), lambda x, d=drop: float(sheer(x)) + d, side)
            sweep("wale", path[np.abs(path[:, 1]) > 0.012], rectangle(0.022, size), m["dark"])
    for brk, facing in ((POOP, 1), (QUARTER, 1), (FORECASTLE, -1)):
        low, high = sorted((deck_height(brk - 0.01), deck_height(brk + 0.01)))
        half = float(half_breadth(brk, high)) - 0.008
        box("bulkhead", (brk, 0, (low + high) / 2 - 0.006), (0.016, 2 * half, high - low + 0.02), m["raw"])
        box(
            "beam",
            (brk + 0.004 * facing, 0, high + 0.002),
            (0.034, 2 * half - 0.006, 0.016),
            m["rail"],
            0.003,
            segments=1,
        )
        for side in SIDES:
            at = brk + 0.010 * facing
            box("door", (at, side * 0.085, low + 0.034), (0.010, 0.056, 0.058), m["red"])
            for offset in (-0.034, 0.034):
                box("pilaster", (at, side * 0.085 + offset, low + 0.036), (0.018, 0.010, 0.072), m["gold"])
    heights = np.linspace(KEEL, -0.17, 9)
    stem = np.stack([bow_x(heights) + 0.004, 0 * heights, heights - 0.006], -1)
    keel = np.concatenate([[(x_, 0, KEEL - 0.010) for x_ in (-0.585, -0.3, 0.1, 0.30)], stem[1:]])
    sweep("keel", keel, rectangle(0.042, 0.030), m["dark"], up=(0, 1, 0))
    post = [(stern_x(h) - 0.010, 0.0, h) for h in (KEEL - 0.02, -0.5, -0.30)]
    sweep("sternpost", post, rectangle(0.030, 0.027), m["dark"], up=(0, 1, 0))
    blade = [(0, KEEL - 0.012), (-0.062, KEEL - 0.008), (-0.085, -0.56), (-0.07, -0.46), (-0.055, -0.27), (0, -0.27)]
    plate("rudder", [(stern_x(h) - 0.028 + dx, 0.0, h) for dx, h in blade], (0, 0.026, 0), m["hull"], 0.004, segments=1)
    for h in (-0.64, -0.52, -0.40):
        box("pintle", (stern_x(h) - 0.035, 0, h), (0.060, 0.036, 0.016), m["black"])


def build_bow_and_stern(m: Palette) -> None:
    """Beakhead with figurehead, bowsprit and anchors; galleries with windows, taffrail and lantern."""
    knee = [
        (0.565, -0.40),
        (0.63, -0.30),
        (0.72, -0.225),
        (0.80, -0.185),
        (0.80, -0.160),
        (0.70, -0.180),
        (0.555, -0.20),
    ]
    plate("knee", [(x, 0.0, z) for x, z in knee], (0, 0.026, 0), m["dark"], 0.004, segments=1)
    bust = [(0, -0.02), (0.016, -0.016), (0.022, 0.0), (0.017, 0.02), (0.011, 0.034)]
    bust += [(0.019, 0.046), (0.019, 0.058), (0.010, 0.068), (0, 0.07)]
    lathe("figurehead", bust, m["gold"], 10, (0.80, 0, -0.17), (0.75, 0, 0.65))
    t = np.linspace(0.0, 1.0, 6)[:, None]
    for side in SIDES:
        for z0, spread, role in ((-0.165, 0.085, "gold"), (-0.235, 0.070, "red")):
            start, middle, end = np.array(
                [(0.515, side * spread, z0), (0.66, side * 0.055, z0 - 0.06), (0.80, side * 0.012, -0.168)]
            )
            tube_along_curve(
                "head rail", (1 - t) ** 2 * start + 2 * t * (1 - t) * middle + t**2 * end, np.full(6, 0.008), m[role], 5
            )
        _anchor(m, side)
    lathe(
        "bowsprit",
        [(0, 0), (0.023, 0), (0.024, 0.12), (0.012, 0.56), (0, 0.565)],
        m["bowsprit"],
        10,
        (0.42, 0, -0.205),
        (0.50, 0, 0.27),
    )
    rake = Matrix.Rotation(-0.240, 3, "Y")

    def fixed(name: str, y: float, z: float, size: tuple[float, float, float], role: str, out: float, bevel: float) -> None:
        box(name, (float(stern_x(z)) - out, y, z), size, m[role], bevel, rake, segments=1)

    for z, count, height in ((-0.17, 5, 0.058), (-0.045, 4, 0.058)):
        span = 1.72 * float(half_breadth(stern_x(z), z))
        for y in (np.arange(count) + 0.5) / count * span - span / 2:
            fixed("window frame", y, z, (0.012, 0.90 * span / count, height), "gold", 0.002, 0.003)
            for dy in (-0.19, 0.19):
                for dz in (-0.23, 0.23):
                    size = (0.010, 0.30 * span / count, 0.36 * height)
                    fixed("pane", y + dy * span / count, z + dz * height, size, "glass", 0.0045, 0.0)
    for z in (-0.225, -0.107, 0.015):
        fixed("cornice", 0.0, z, (0.040, 2.06 * float(half_breadth(stern_x(z), z)), 0.020), "rail", 0.010, 0.005)
    width = float(half_breadth(stern_x(0.03), 0.03))
    s = np.linspace(-1.0, 1.0, 11)
    crest = 0.072 - 0.045 * np.abs(s) ** 1.6
    outline = [(stern_x(0.02) - 0.004, y, 0.02) for y in (-width, width)]
    outline += [(stern_x(0.02) - 0.004 - 0.245 * h, y, 0.02 + h) for y, h in zip(width * s[::-1], crest, strict=True)]
    plate("taffrail", outline, (0.018, 0, 0), m["hull"], 0.003, segments=1)
    lathe(
        "lantern",
        [(0, -0.03), (0.005, -0.028), (0.005, -0.004), (0.022, 0.0), (0.026, 0.006), (0, 0.006)],
        m["gold"],
        8,
        (-0.80, 0, 0.14),
    )
    lathe("lantern light", [(0, 0.004), (0.019, 0.004), (0.025, 0.034), (0, 0.034)], m["glass"], 8, (-0.80, 0, 0.14))
    lathe(
        "lantern roof",
        [(0, 0.032), (0.031, 0.032), (0.022, 0.044), (0.006, 0.052), (0.006, 0.06), (0, 0.064)],
        m["gold"],
        8,
        (-0.80, 0, 0.14),
    )
    tube_along_curve(
        "lantern arm",
        np.array([(-0.765, 0, 0.06), (-0.79, 0, 0.08), (-0.80, 0, 0.12)]),
        np.full(3, 0.007),
        m["black"],
        6,
    )


def _anchor(m: Palette, side: float) -> None:
    """Anchor lashed to the bow, under its stock."""
    y = side * (float(half_breadth(0.44, -0.26)) + 0.028)
    tube_along_curve("anchor shank", np.array([(0.445, y, -0.22), (0.435, y, -0.40)]), np.array([0.009, 0.011]), m["black"], 6)
    a = np.linspace(-1.15, 1.15, 7)
    arms = np.stack([0.434 + 0.062 * np.sin(a), np.full(7, y), -0.335 - 0.066 * np.cos(a)], -1)
    tube_along_curve("anchor arms", arms, 0.011 - 0.004 * np.abs(a), m["black"], 6)
    box("anchor stock", (0.445, y, -0.235), (0.125, 0.016, 0.018), m["dark"], 0.003, segments=1)


# ---------------------------------------------------------------- stand
def build_stand(m: Palette) -> None:
    """Base board, two supports cut to the hull's section, and a name plate."""
    box("base", (-0.08, 0, -0.842), (0.76, 0.28, 0.034), m["stand"], 0.010)
    box("base step", (-0.08, 0, -0.818), (0.69, 0.22, 0.022), m["stand"], 0.006)
    for x in (-0.32, 0.16):
        zs = np.linspace(KEEL + 0.012, -0.53, 6)
        flank = [(float(half_breadth(x, z)) + 0.003, float(z)) for z in zs]
        right = [
            (0.0, KEEL - 0.022),
            (0.024, KEEL - 0.022),
            *flank,
            (flank[-1][0] + 0.022, -0.53),
            (0.13, -0.66),
            (0.085, -0.73),
            (0.105, -0.82),
        ]
        outline = [(x, y, z) for y, z in right] + [(x, -y, z) for y, z in reversed(right[1:])]
        plate("support", outline, (0.045, 0, 0), m["stand"], 0.005, segments=1)
    box("tie", (-0.08, 0, -0.785), (0.50, 0.030, 0.030), m["stand"], 0.005, segments=1)
    for side in SIDES:
        box("name plate", (-0.08, side * 0.140, -0.842), (0.20, 0.006, 0.020), m["gold"])


def build() -> None:
    """Build the ship in the current, empty scene."""
    materials = palette(KEEL, (SHEER, SHEER_X, SHEER_Z))
    build_hull(materials)
    build_bow_and_stern(materials)
    build_fittings(materials)
    build_masts_and_sails(materials)
    build_rigging(materials)
    build_stand(materials)
