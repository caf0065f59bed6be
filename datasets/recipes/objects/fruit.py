"""A turned wooden bowl of fruit on a small linen cloth: apples, an orange, lemons, a pear, dark grapes over the rim.

Natural peels with fine patterns and soft gloss, a dull bloom over gloss on nearly black grapes, deep shadows between round
things that touch. `fruit_pile.py` finds where everything lies.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import fruit_paint as paints
from .craft import stitches, strip
from .forms import grid_surface, sheet, smooth_path, tube_along_curve
from .fruit_pile import FALLEN, FRUIT, PROFILE, TABLE, settle, stalk, turned_to

HALF, HEM = 0.575, 0.046
"""Half the width of the cloth and the width of its hem."""

Profile = list[tuple[float, float]]


def build() -> None:
    """Build the bowl of fruit in the empty scene, within the unit sphere."""
    rng = np.random.default_rng(3)
    places, grapes = settle()
    _cloth()
    _bowl()
    _apples(places, rng)
    _citrus(places, rng)
    _pear(places["pear"])
    _grapes(grapes)
    _leaves(places)


# ---------------------------------------------------------------- cloth and bowl
def _rise(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the cloth over the table: flat under the bowl, waves outside, a corner thrown back."""
    out = np.clip((np.hypot(x, y) - 0.30) / 0.45, 0.0, 1.0) ** 1.3
    angle = np.arctan2(y, x)
    wave = 0.5 + 0.34 * np.sin(5.0 * angle + 6.0 * x) + 0.16 * np.sin(9.0 * angle - 5.0 * y + 1.0)
    corner = np.clip((x - y - 0.80) / 0.37, 0.0, 1.0)
    return 0.055 * out * wave + 0.10 * corner**2


def _on_cloth(x: np.ndarray, y: np.ndarray, lift: float = 0.0) -> np.ndarray:
    """Points (..., 3) over the cloth's upper side where the weave's coordinates are x and y."""
    return np.stack([x, y, TABLE + _rise(x, y) + lift], axis=-1)


def _cloth() -> None:
    """Square of linen, twice as thick along its hem, the hem sewn down by hand."""
    inner = HALF - HEM
    inside = np.linspace(-inner + 0.012, inner - 0.012, 18)
    rim = np.array([HALF, HALF - 0.006, inner + 0.006, inner - 0.003])
    steps = np.concatenate([-rim, inside, rim[::-1]])
    y, x = np.meshgrid(steps, steps, indexing="ij")
    inward = HALF - np.maximum(np.abs(x), np.abs(y))
    fold = np.clip((HEM - inward) / 0.009, 0.0, 1.0) * np.clip(inward / 0.006, 0.0, 1.0)
    points = _on_cloth(x, y, -0.006) + np.stack([0.0 * x, 0.0 * y, 0.007 * fold], axis=-1)
    sheet("cloth", points, paints.linen(HALF, HEM), 0.012, 60.0)
    along = np.linspace(-inner + 0.03, inner - 0.03, 17)
    starts, ends, up = [], [], []
    for sign, turned in ((-1, False), (1, False), (-1, True), (1, True)):
        line = [np.stack([along + d, np.full_like(along, sign * (inner + e))]) for d, e in ((-0.012, 0.012), (0.012, -0.010))]
        a, b = (_on_cloth(*(part[::-1] if turned else part), lift) for part, lift in zip(line, (0.009, 0.002), strict=True))
        starts, ends, up = [*starts, a], [*ends, b], [*up, np.tile((0.0, 0.0, 1.0), (len(a), 1))]
    stitches("hem stitches", *(np.concatenate(part) for part in (starts, ends, up)), 0.011, paints.thread())


def _bowl() -> None:
    """Turned bowl, a little oval since it dried."""
    angle = np.linspace(0.0, 2.0 * np.pi, 46, endpoint=False)
    radius, height = PROFILE[1:-1, :1], PROFILE[1:-1, 1:]
    warp = 1.0 + 0.007 * np.cos(2.0 * angle - 0.6)
    rows = np.stack([radius * warp * np.cos(angle), radius * warp * np.sin(angle), height + 0.0 * angle + TABLE], axis=-1)
    rows[..., 2] += 0.006 * np.cos(2.0 * angle - 0.6) * height / 0.58
    grid_surface("bowl", rows, paints.wood(TABLE), sharp_deg=48.0)


# ---------------------------------------------------------------- fruit
def _place(name: str, local: np.ndarray, centre: np.ndarray, spin: float, paint: bpy.types.Material) -> None:
    """Rings (rows, columns, 3) of a fruit of unit size, from eye to stem, at its place in the pile; its chart is `local`."""
    lump = FRUIT[name]
    c, s = np.cos(spin), np.sin(spin)
    turn = turned_to(lump.axis) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    chart = np.concatenate([local, local[:, :1]], axis=1)
    grid_surface(name, lump.size * local @ turn.T + centre, paint, chart)


def _round(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Polar angle from the eye (rows, 1), closer together at both ends, and angle round the axis (columns,)."""
    t = np.linspace(0.0, 1.0, rows)
    polar = 0.05 + (np.pi - 0.10) * (t - 0.07 * np.sin(2.0 * np.pi * t))
    return polar[:, None], np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)


def _apples(places: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    """Four apples with their stems, each of another kind."""
    rind = {
        "red": (((0.50, 0.36, 0.07), (0.62, 0.42, 0.12)), ((0.30, 0.030, 0.032), (0.52, 0.075, 0.045)), 0.92),
        "green": (((0.25, 0.38, 0.05), (0.40, 0.50, 0.10)), ((0.40, 0.22, 0.05), (0.46, 0.16, 0.06)), 0.10),
        "golden": (((0.55, 0.44, 0.07), (0.66, 0.50, 0.15)), ((0.55, 0.14, 0.04), (0.62, 0.26, 0.07)), 0.40),
        "blushed": (((0.52, 0.46, 0.09), (0.58, 0.40, 0.10)), ((0.38, 0.040, 0.035), (0.58, 0.13, 0.06)), 0.66),
    }
    bark = paints.stem()
    polar, angle = _round(18, 26)
    for number, (name, (ground, blush, red)) in enumerate(rind.items()):
        phase, lean = rng.uniform(0.0, 2.0 * np.pi, 2)
        s, c = np.sin(polar), -np.cos(polar)
        lobes = 1.0 + 0.040 * np.cos(5.0 * angle + phase) * np.clip(0.35 - 0.65 * c, 0.0, 1.0) + 0.02 * np.cos(2 * angle + lean)
        radius = s * (1.0 + 0.07 * c) * lobes
        z = 0.83 * c - 0.38 * np.exp(-((radius / 0.26) ** 2)) * (c > 0) + 0.20 * np.exp(-((radius / 0.22) ** 2)) * (c <= 0)
        z = z + 0.07 * radius * np.cos(angle - lean) * np.clip(c, 0.0, 1.0)
        local = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)
        _place(name, local, places[name], rng.uniform(0.0, 6.0), paints.apple(name, ground, blush, red, 5.0 * number))
        lump = FRUIT[name]
        tip = rng.uniform(-0.16, 0.16, 2)
        twig = np.array([(0.0, 0.0, 0.40), (0.2 * tip[0], 0.2 * tip[1], 0.62), (*tip, rng.uniform(0.80, 0.98))])
        path = lump.size * smooth_path(twig, 6) @ turned_to(lump.axis).T + places[name]
        tube_along_curve("stem", path, 0.014 * np.array([0.8, 0.62, 0.55, 0.60, 0.75, 1.0]), bark, 6)


def _citrus(places: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    """An orange and two lemons with peels in relief, and the orange's button."""
    polar, angle = _round(26, 38)
    s, c = np.sin(polar), -np.cos(polar)
    radius = s * (1.0 + 0.016 * np.cos(9.0 * angle) * np.clip(c, 0.0, 1.0) ** 6)
    z = 0.95 * c - 0.09 * np.exp(-((radius / 0.20) ** 2)) * (c > 0) + 0.10 * np.exp(-((radius / 0.13) ** 2)) * (c <= 0)
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)
    local *= 1.0 + (0.010 * rng.normal(size=radius.shape) * np.minimum(1.0, 3.0 * s))[..., None]
    peel = paints.citrus("orange", (0.70, 0.27, 0.025), (0.60, 0.17, 0.02), (0.55, 0.42, 0.05), 7.0)
    _place("orange", local, places["orange"], 0.7, peel)
    button = np.linspace(0.84, 0.93, 4) * FRUIT["orange"].size
    path = places["orange"] + np.outer(button, turned_to(FRUIT["orange"].axis)[:, 2])
    star = 1.0 + 0.25 * np.cos(5.0 * np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False))
    tube_along_curve("button", path, np.outer((0.022, 0.022, 0.017, 0.006), star), paints.stem(), 10)

    outline: Profile = [(0.05, -1.36), (0.15, -1.34), (0.21, -1.27), (0.33, -1.17), (0.62, -0.93), (0.88, -0.55), (1.0, 0.0)]
    outline += [(0.93, 0.47), (0.74, 0.84), (0.47, 1.10), (0.30, 1.22), (0.25, 1.36), (0.17, 1.46), (0.05, 1.49)]
    peel = paints.citrus("lemon", (0.74, 0.56, 0.07), (0.62, 0.42, 0.035), (0.36, 0.42, 0.07), 6.0)
    for name, count in (("lemon", 28), ("small_lemon", 24)):
        line = smooth_path(np.array([(r, 0.0, z) for r, z in outline]), 21)
        angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        radius = line[:, :1] * (1.0 + 0.02 * np.cos(3.0 * angle + count) + 0.013 * rng.normal(size=(21, count)))
        height = line[:, 2:] + 0.05 * radius * np.cos(angle)
        local = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
        _place(name, local, places[name], 0.1 * count, peel)


def _pear(centre: np.ndarray) -> None:
    """Pear with a bent neck and its stem."""
    outline: Profile = [(0.06, -0.80), (0.20, -0.88), (0.46, -0.87), (0.74, -0.68), (0.91, -0.34), (0.90, 0.04), (0.74, 0.38)]
    outline += [(0.55, 0.70), (0.43, 1.00), (0.37, 1.26), (0.27, 1.42), (0.13, 1.47), (0.05, 1.45)]
    line = smooth_path(np.array([(r, 0.0, z) for r, z in outline]), 22)
    angle = np.linspace(0.0, 2.0 * np.pi, 26, endpoint=False)
    radius = line[:, :1] * (1.0 + 0.035 * np.cos(3.0 * angle + 2.0 * line[:, 2:]) + 0.02 * np.cos(2.0 * angle + 1.0))
    bend = 0.06 * np.clip(line[:, 2:], 0.0, None) ** 2
    local = np.stack([radius * np.cos(angle) + bend, radius * np.sin(angle), line[:, 2:] + 0.0 * angle], axis=-1)
    _place("pear", local, centre, 0.0, paints.pear())
    twig = smooth_path([(0.12, 0.0, 1.40), (0.16, 0.02, 1.62), (0.27, 0.10, 1.90)], 7)
    path = FRUIT["pear"].size * twig @ turned_to(FRUIT["pear"].axis).T + centre
    tube_along_curve("stem", path, 0.015 * np.array([1.0, 0.8, 0.68, 0.62, 0.64, 0.75, 1.0]), paints.stem(), 7)


def _grapes(grapes: np.ndarray) -> None:
    """The bunch, each grape on its own stalklet, and the grapes that fell."""
    skin, bark = paints.grape(), paints.stem()
    spine = stalk(60) + (0.0, 0.0, TABLE)
    tube_along_curve("stalk", smooth_path(stalk(9) + (0.0, 0.0, TABLE), 15), np.linspace(0.015, 0.006, 15), bark, 5)
    fallen = np.column_stack([_on_cloth(FALLEN[:, 0], FALLEN[:, 1]), FALLEN[:, 2]])
    fallen[:, 2] += 0.97 * fallen[:, 3]
    polar = np.linspace(0.10, np.pi - 0.10, 6)[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, 9, endpoint=False)
    ball = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), -np.cos(polar) + 0.0 * angle], axis=-1)
    chance = np.random.default_rng(5).uniform(size=len(grapes) + len(fallen))
    for number, (x, y, z, radius) in enumerate(np.concatenate([grapes, fallen])):
        centre = np.array((x, y, z))
        nearest = spine[np.argmin(np.linalg.norm(spine - centre, axis=1))]
        hangs = number < len(grapes)
        axis = nearest - centre if hangs else np.array((0.9, 0.5 - number % 3, 0.2))
        shape = radius * ball * (0.97, 0.97, 1.10) @ turned_to(axis).T
        chart = np.empty((6, 10, 3))
        chart[..., 0], chart[..., 1], chart[..., 2] = -np.cos(polar), chance[number], 0.0
        grid_surface("grape", shape + centre, skin, chart)
        if hangs and np.linalg.norm(axis) > radius:
            ends = np.stack([centre + 0.98 * radius * axis / np.linalg.norm(axis), nearest])
            tube_along_curve("stalklet", ends, np.array((0.007, 0.0055)), bark, 4)


# ---------------------------------------------------------------- leaves
def _leaf(root: np.ndarray, tip: np.ndarray, up: np.ndarray, width: float, curl: float, paint: bpy.types.Material) -> None:
    """Pointed leaf with a saw edge from root to tip, folded along its rib, its tip curled along `up` by `curl`."""
    along, across = np.linspace(0.0, 1.0, 13)[:, None], np.linspace(-1.0, 1.0, 7)
    heading = tip - root
    side = np.cross(heading / np.linalg.norm(heading), up / np.linalg.norm(up))
    up = np.cross(side, heading / np.linalg.norm(heading))
    outline = np.sin(np.pi * along**0.72) ** 0.85 * (1.0 - 0.25 * along) + 0.03
    saw = 1.0 + 0.07 * np.where(np.arange(13) % 2, 1.0, -1.0)[:, None] * np.abs(across) ** 3
    lift = curl * along**2 + 0.30 * width * np.abs(across) ** 1.3 * outline + 0.05 * width * np.cos(14.0 * along) * across**2
    lift = lift + 0.12 * width * np.sin(4.0 * along + 2.0 * across)
    points = root + along[..., None] * heading + (width * across * outline * saw)[..., None] * side + lift[..., None] * up
    strip("leaf", points, paint, 0.009)


def _leaves(places: dict[str, np.ndarray]) -> None:
    """Leaves on two stems, and a withered one on the cloth."""
    green, autumn = ((0.055, 0.115, 0.032), (0.13, 0.21, 0.05)), ((0.42, 0.24, 0.05), (0.30, 0.12, 0.04))
    fresh, dry = paints.leaf("green leaf", green, autumn, 0.08), paints.leaf("dry leaf", green, autumn, 0.62)
    for name, foot, out, width, curl in (
        ("pear", 1.66, (0.26, -0.14, 0.10), 0.085, -0.13),
        ("blushed", 0.62, (0.24, -0.20, 0.07), 0.075, -0.09),
        ("golden", 0.60, (-0.16, 0.06, 0.20), 0.070, -0.05),
    ):
        root = places[name] + FRUIT[name].size * foot * turned_to(FRUIT[name].axis)[:, 2]
        _leaf(root, root + np.array(out), np.array((0.0, 0.0, 1.0)), width, curl, fresh)
    root, tip = _on_cloth(np.array((-0.50, -0.22)), np.array((0.30, 0.50)), 0.012)
    _leaf(root, tip, np.array((0.0, 0.0, 1.0)), 0.085, 0.05, dry)
