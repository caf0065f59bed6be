"""A wooden galleon model on a display cradle: planked and painted hull, fitted decks, three rigged masts with sails.

The bow points along +x. The hull is one analytic surface (`ship_form.half_breadth`), from which skin, decks, wales,
railings, cradle and rigging feet take their points, so that parts meet wherever they are placed.
"""

from __future__ import annotations

import bpy  # noqa: F401  (mathutils can be imported only after bpy)
import numpy as np

# isort: split
from mathutils import Matrix

from .common import box, lathe, plate, sheet, sweep, tube_along_curve
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

    def fixed(
        name: str, y: float, z: float, size: tuple[float, float, float], role: str, out: float, bevel: float
    ) -> None:
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
    tube_along_curve(
        "anchor shank", np.array([(0.445, y, -0.22), (0.435, y, -0.40)]), np.array([0.009, 0.011]), m["black"], 6
    )
    a = np.linspace(-1.15, 1.15, 7)
    arms = np.stack([0.434 + 0.062 * np.sin(a), np.full(7, y), -0.335 - 0.066 * np.cos(a)], -1)
    tube_along_curve("anchor arms", arms, 0.011 - 0.004 * np.abs(a), m["black"], 6)
    box("anchor stock", (0.445, y, -0.235), (0.125, 0.016, 0.018), m["dark"], 0.003, segments=1)


# ---------------------------------------------------------------- deck fittings
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
    profile = np.array(
        [(0, 0), (0.019, 0), (0.0242, 0.018), (0.0242, 0.034), (0.019, 0.052), (0.016, 0.052), (0, 0.047)]
    )
    lathe("barrel", profile * size, m["raw"], 9, (x, y, z))
    for h, r in ((0.012, 0.0235), (0.040, 0.0235)):
        hoop = np.array([(0, h - 0.003), (r, h - 0.003), (r, h + 0.003), (0, h + 0.003)])
        lathe("hoop", hoop * size, m["black"], 9, (x, y, z))


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
