"""Masts, yards, sails, flags and rigging of the ship."""

from __future__ import annotations

import bpy  # noqa: F401  (mathutils can be imported only after bpy)
import numpy as np

# isort: split
from mathutils import Matrix

from .forms import box, lathe, sheet, tube_along_curve
from .ship_form import SIDES, half_breadth, rail_height, sheer
from .ship_paint import Palette

MASTS = {  # x, foot, hounds of the lower mast (where the top sits), head, radius
    "fore": (0.37, -0.24, 0.20, 0.80, 0.021),
    "main": (-0.05, -0.36, 0.28, 0.95, 0.025),
    "mizzen": (-0.45, -0.22, 0.22, 0.60, 0.018),
}


def build_masts_and_sails(m: Palette) -> None:
    """Masts with tops, yards, five square sails, the lateen mizzen, flags."""
    for x, foot, hounds, head, r in MASTS.values():
        middle = hounds + 0.55 * (head - hounds)
        radii = r * np.array([0, 1, 0.85, 0.5, 0.5, 0.72, 0.72, 0.42, 0.30, 0.8, 0])
        steps = (foot, foot, hounds + 0.06, hounds + 0.075, middle, middle, middle + 0.014, middle + 0.02)
        profile = list(zip(radii, (*steps, head, head + 0.004, head + 0.016), strict=True))
        lathe("mast", profile, m["mast"], 10, (x, 0, 0))
        for h in np.linspace(foot + 0.14, hounds - 0.05, 3):
            lathe(
                "woolding",
                [(0, h - 0.007), (r + 0.003, h - 0.007), (r + 0.003, h + 0.007), (0, h + 0.007)],
                m["rope"],
                8,
                (x, 0, 0),
            )
        top = np.array(
            [
                (0, 0),
                (0.026, 0),
                (0.054, 0.040),
                (0.062, 0.040),
                (0.062, 0.050),
                (0.048, 0.050),
                (0.024, 0.012),
                (0, 0.012),
            ]
        )
        lathe("crow's nest", top * (r / 0.025) ** 0.6, m["rail"], 12, (x, 0, hounds))
    for mast, cloth, z_yard, z_foot, w_yard, w_foot, belly in (
        ("fore", "canvas_star", 0.135, -0.105, 0.25, 0.27, 0.115),
        ("fore", "canvas", 0.455, 0.185, 0.175, 0.24, 0.095),
        ("fore", "canvas", 0.70, 0.495, 0.105, 0.165, 0.065),
        ("main", "canvas_cross", 0.205, -0.100, 0.31, 0.33, 0.13),
        ("main", "canvas", 0.57, 0.265, 0.215, 0.30, 0.11),
        ("main", "canvas", 0.845, 0.615, 0.125, 0.205, 0.075),
    ):
        _square_sail(m, MASTS[mast][0] + 0.034, cloth, (z_yard, z_foot), (w_yard, w_foot), belly)
    _lateen(m)
    for start, role, length, height in (
        ((-0.05, 0, 0.925), "pennant", 0.19, 0.045),
        ((0.37, 0, 0.775), "flag", 0.17, 0.05),
        ((-0.45, 0, 0.575), "pennant", 0.15, 0.045),
        ((-0.79, 0, 0.235), "flag", 0.17, 0.11),
    ):
        s, t = np.meshgrid(np.linspace(0, 1, 11), np.linspace(-0.5, 0.5, 3))
        taper = 1.0 - (0.75 * s if role == "pennant" else 0.12 * s)
        wave = 0.022 * np.sin(9.0 * s + 1.5 * t) * s**0.6
        points = np.stack([start[0] - length * s, wave, start[2] + height * t * taper - 0.03 * s * s], -1)
        sheet("flag", points, m[role], 0.007)
    tube_along_curve("flagstaff", np.array([(-0.765, 0, 0.05), (-0.788, 0, 0.31)]), np.array([0.009, 0.006]), m["mast"], 8)


def _yard(m: Palette, centre: tuple[float, float, float], half: float, axis: tuple[float, float, float], r: float) -> None:
    profile = [
        (0, -half),
        (0.45 * r, -half),
        (0.8 * r, -0.5 * half),
        (r, 0),
        (0.8 * r, 0.5 * half),
        (0.45 * r, half),
        (0, half),
    ]
    lathe("yard", profile, m["yard"], 8, centre, axis)


def _square_sail(m: Palette, x: float, cloth: str, z: tuple[float, float], width: tuple[float, float], belly: float) -> None:
    """Sail bent to its yard at z[0], half widths `width` at head and foot, filled from astern."""
    _yard(m, (x, 0, z[0] + 0.010), width[0] + 0.045, (0, 1, 0), 0.014)
    columns = 7 + 2 * int(13.0 * width[1])
    s, t = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(0, 1, 2 * columns // 3))
    fill = (1.0 - np.abs(s) ** 2.4) * np.sin(np.pi * (0.86 * t) ** 0.8) + 0.16 * t
    crease = 0.006 * np.cos(3.0 * np.pi * s) * (1.0 - t) ** 2 + 0.005 * np.sin(7.0 * s + 5.0 * t)
    half = (width[0] + (width[1] - width[0]) * t) * (1.0 - 0.07 * np.sin(np.pi * t))
    height = z[0] + (z[1] - z[0]) * t + 0.045 * t**3 * (1.0 - s * s) - 0.004 * np.cos(3.0 * np.pi * s) * (1.0 - t) ** 3
    sheet("sail", np.stack([x + 0.012 + belly * fill + crease, s * half, height], -1), m[cloth], 0.008)
    for y in np.array([-1.0, -1 / 3, 1 / 3, 1.0]) * (width[0] - 0.008):
        wrap = [(0, -0.008), (0.018, -0.008), (0.018, 0.008), (0, 0.008)]
        lathe("gasket", wrap, m["rope"], 6, (x + 0.003, y, z[0] + 0.008), (0, 1, 0))
    for side in SIDES:
        clew = (x + 0.012 + 0.16 * belly, side * width[1], z[1])
        foot_x = x - 0.17
        foot = (
            (foot_x, side * float(half_breadth(foot_x, -0.26)), rail_height(foot_x))
            if z[1] < 0
            else (x, side * width[1] * 0.98, z[1] - 0.05)
        )
        tube_along_curve("sheet", np.array([clew, foot]), np.full(2, 0.006), m["rope"], 5)


def _lateen(m: Palette) -> None:
    """Triangular mizzen sail on its slanted yard."""
    peak, tack, clew = np.array([(-0.69, 0.03, 0.50), (-0.24, 0.03, -0.015), (-0.735, 0.03, 0.10)])
    axis = peak - tack
    _yard(m, tuple((peak + tack) / 2 + (0, -0.005, 0.012)), 0.5 * float(np.linalg.norm(axis)) + 0.03, tuple(axis), 0.013)
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 0.96, 9))
    head = tack + s[..., None] * axis
    points = head + t[..., None] * (clew - head)
    points[..., 1] += 0.30 * t * (1.0 - t) * np.sin(np.pi * s) ** 0.8 + 0.004 * np.sin(11.0 * s)
    sheet("lateen sail", points, m["canvas"], 0.008)
    tube_along_curve("mizzen sheet", np.array([clew, (-0.775, 0.0, 0.085)]), np.full(2, 0.006), m["rope"], 5)


def build_rigging(m: Palette) -> None:
    """Shrouds with deadeyes, channels and ratlines, stays, backstays."""
    for x, _, hounds, head, _ in MASTS.values():
        count = 5 if x == MASTS["main"][0] else 4
        feet_x = x - 0.015 - 0.042 * np.arange(count)
        for side in SIDES:
            z = float(sheer(x)) + (0.075 if count == 5 else 0.105)
            feet = np.array([(v, side * (float(half_breadth(v, z)) + 0.026), z + 0.012) for v in feet_x])
            ends = np.array([(x - 0.006 * k, side * 0.018, hounds) for k in range(count)])
            middle = feet.mean(axis=0)
            turn = Matrix.Rotation(float(np.arctan2(*(feet[0] - feet[-1])[1::-1])), 3, "Z")
            box(
                "channel",
                (middle[0], middle[1] - side * 0.010, z - 0.006),
                (0.042 * count + 0.02, 0.042, 0.010),
                m["dark"],
                turn=turn,
            )
            for foot, end in zip(feet, ends, strict=True):
                tube_along_curve("shroud", np.array([foot, end]), np.array([0.0072, 0.006]), m["tarred"], 5)
                lathe(
                    "deadeye",
                    [(0, -0.007), (0.011, -0.005), (0.011, 0.005), (0, 0.007)],
                    m["black"],
                    6,
                    foot,
                    (0, 1, 0.2),
                )
            for f in np.linspace(0.12, 0.80, 6):
                line = (feet + f * (ends - feet))[[0, -1]]
                tube_along_curve("ratline", line, np.full(2, 0.006), m["tarred"], 4)
            upper = np.array([(x - 0.03, side * 0.046, hounds + 0.045), (x, side * 0.006, hounds + 0.50 * (head - hounds))])
            tube_along_curve("topmast shroud", upper, np.full(2, 0.006), m["tarred"], 5)
    fore, main, mizzen = MASTS["fore"], MASTS["main"], MASTS["mizzen"]
    for start, end, sag in (
        ((fore[0], 0, fore[2]), (0.72, 0, -0.045), 0.012),
        ((fore[0], 0, 0.54), (0.85, 0, 0.025), 0.016),
        ((fore[0], 0, fore[3]), (0.905, 0, 0.055), 0.020),
        ((main[0], 0, main[2]), (fore[0] - 0.02, 0, -0.12), 0.010),
        ((main[0], 0, 0.65), (fore[0], 0, fore[2] + 0.07), 0.014),
        ((main[0], 0, main[3]), (fore[0], 0, 0.55), 0.018),
        ((mizzen[0], 0, mizzen[2]), (main[0] - 0.02, 0, -0.16), 0.010),
        ((mizzen[0], 0, mizzen[3]), (main[0], 0, main[2] + 0.07), 0.016),
    ):
        t = np.linspace(0.0, 1.0, 5)[:, None]
        line = np.array(start) + t * (np.array(end) - np.array(start)) - (0, 0, 4.0 * sag) * t * (1.0 - t)
        tube_along_curve("stay", line, np.full(5, 0.0065), m["tarred"], 5)
    for x, _, _, head, _ in (fore, main):
        for side in SIDES:
            foot = (x - 0.22, side * (float(half_breadth(x - 0.22, -0.26)) + 0.01), rail_height(x - 0.22))
            tube_along_curve("backstay", np.array([(x, 0, head - 0.05), foot]), np.full(2, 0.006), m["tarred"], 5)
