"""A sewn cloth bear, sitting: felt head and limbs, a corduroy body, patches of printed calico, a satin bow.

Matt cloth nearly everywhere, with prints, nap, mended and rubbed places; two black buttons and a ribbon are glossy.
It faces -y, its head a little turned.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import bear_paint as paints
from .craft import Skin, pad, stitches, strip
from .forms import grid_surface, smooth_path, tube_along_curve

TAU = 2.0 * np.pi
WALES = 56
"""Ridges of the corduroy round the body."""

HEAD = np.array((0.0, -0.02, 0.46))
"""Centre of the head."""

NECK = 0.135
"""Height of the ribbon round the neck."""

Colours = dict[str, bpy.types.Material]


def build() -> None:
    """Build the bear in the empty scene, within the unit sphere."""
    cream, navy, rose = (0.70, 0.62, 0.47), (0.040, 0.050, 0.12), (0.52, 0.085, 0.10)
    cloths: Colours = {
        "felt": paints.felt("honey felt", (0.47, 0.28, 0.115), (0.25, 0.125, 0.048), (0.50, 0.40, 0.26)),
        "pale": paints.felt("pale felt", (0.64, 0.50, 0.31), (0.42, 0.29, 0.155), (0.55, 0.47, 0.34)),
        "corduroy": paints.corduroy(),
        "navy": paints.calico("navy calico", (navy, (0.060, 0.080, 0.17)), ((0.62, 0.50, 0.40), rose), 9.0),
        "cream": paints.calico("cream calico", (cream, (0.62, 0.50, 0.36)), (rose, (0.10, 0.16, 0.36)), 11.0),
        "ticking": paints.ticking("ticking", (0.66, 0.60, 0.49), (0.075, 0.12, 0.26), (0.50, 0.12, 0.08), 0.062),
        "gingham": paints.gingham("gingham", (0.68, 0.62, 0.52), (0.46, 0.060, 0.055), 0.060),
        "check": paints.gingham("green check", (0.60, 0.58, 0.42), (0.045, 0.13, 0.085), 0.048),
        "thread": paints.thread("pale thread", (0.76, 0.68, 0.52), (0.55, 0.46, 0.32)),
        "dark": paints.thread("dark thread", (0.10, 0.062, 0.045), (0.045, 0.034, 0.031)),
        "red": paints.thread("red thread", (0.46, 0.06, 0.05), (0.28, 0.04, 0.04)),
    }
    torso = _body(cloths)
    _head(cloths)
    _arms(cloths)
    _legs(cloths)
    _bow(torso, paints.satin())


def _lumps(u: np.ndarray, v: np.ndarray, seed: float) -> np.ndarray:
    """Unevenness of the stuffing, about -1 to 1, round in u."""
    a = TAU * u
    return 0.5 * np.sin(2 * a + 7.0 * v + seed) + 0.3 * np.sin(3 * a - 9.0 * v + 2 * seed) + 0.2 * np.sin(a + 15.0 * v)


def _rings(sections: list[tuple[float, ...]], rows: int, columns: int, axes: np.ndarray, seed: float, lump: float) -> np.ndarray:
    """Rings (rows, columns, 3) through sections (height, centre a, centre b, radius a, radius b) of axes (a, b, height)."""
    s = smooth_path(np.array(sections, float), rows)
    u, v = np.linspace(0.0, 1.0, columns, endpoint=False), np.linspace(0.0, 1.0, rows)[:, None]
    swell = 1.0 + lump * _lumps(u, v, seed) * np.sin(np.pi * v) ** 0.5
    local = np.stack([s[:, 1:2] + s[:, 3:4] * swell * np.cos(TAU * u), s[:, 2:3] + s[:, 4:5] * swell * np.sin(TAU * u),
                      s[:, :1] + 0.0 * u], axis=-1)  # fmt: skip
    return local @ axes.T


# ---------------------------------------------------------------- body
def _body(cloths: Colours) -> Skin:
    """Corduroy body with seams in front and behind, mended three times."""
    sections = [(-0.790, 0, 0.02, 0.09, 0.09), (-0.775, 0, 0.02, 0.24, 0.23), (-0.70, 0, 0.01, 0.365, 0.345),
                (-0.58, 0, 0.0, 0.42, 0.395), (-0.44, 0, -0.005, 0.43, 0.40), (-0.28, 0, 0.0, 0.395, 0.365),
                (-0.12, 0, 0.0, 0.33, 0.30), (0.02, 0, 0.0, 0.255, 0.235), (0.11, 0, 0.0, 0.195, 0.185),
                (0.18, 0, 0.0, 0.14, 0.14)]  # fmt: skip
    rings = _rings(sections, 21, 2 * WALES, np.eye(3), 0.7, 0.018)
    u, v = np.arange(2 * WALES) / (2 * WALES), np.linspace(0.0, 1.0, 21)[:, None]
    for seam in (0.25, 0.75):
        rings -= (0.022 * np.exp(-(((u - seam) / 0.012) ** 2)) * np.sin(np.pi * v))[..., None] * np.stack(
            [np.cos(TAU * u), np.sin(TAU * u), 0.0 * u], axis=-1
        )
    torso = Skin(rings)
    ridge = np.where(np.arange(2 * WALES) % 2, -0.5, 0.5) * 0.013 * np.sin(np.pi * v) ** 0.3
    torso.build("body", cloths["corduroy"], (float(WALES), 1.0), ridge)
    for at, count, thread in ((0.75, 19, "thread"), (0.25, 21, "red")):
        along = np.linspace(0.24, 0.86, count)
        torso.seam("body seam", np.full(count, at), along, 0.030, 0.35, cloths[thread], 0.005)
    torso.patch("belly patch", (0.655, 0.44), (0.125, 0.140), 0.18, cloths["cream"], cloths["red"], 0.006)
    torso.patch("side patch", (0.905, 0.38), (0.105, 0.090), -0.30, cloths["gingham"], cloths["thread"], 0.006)
    torso.patch("back patch", (0.335, 0.50), (0.115, 0.130), 0.25, cloths["ticking"], cloths["thread"], 0.006)
    return torso


# ---------------------------------------------------------------- head
def _turned(points: np.ndarray) -> np.ndarray:
    """Directions (..., 3) of the head's frame in the world: turned to its left, nodding, leaning."""
    yaw, lean, nod = np.radians((11.0, 5.0, 4.0))
    z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    y = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    x = np.array([[1, 0, 0], [0, np.cos(nod), -np.sin(nod)], [0, np.sin(nod), np.cos(nod)]])
    return points @ (z @ y @ x).T


def _facing(normal: tuple[float, float, float]) -> np.ndarray:
    """Axes (3, 3) of a pad on the head: right and up as one sees it, then `normal`, of the head's frame, in the world."""
    n = np.array(normal) / np.linalg.norm(normal)
    right = np.cross((0.0, 0.0, 1.0), n)
    right /= np.linalg.norm(right)
    return _turned(np.stack([right, np.cross(n, right), n])).T


def _head(cloths: Colours) -> None:
    """Head of two halves, muzzle, ears, embroidered nose and mouth, button eyes."""
    rows, columns = 24, 36
    t = np.linspace(0.03, 0.97, rows)[:, None] * np.pi
    u = np.linspace(0.0, 1.0, columns, endpoint=False)
    c, s = -np.cos(t), np.sin(t)
    cheeks = 1.0 + 0.07 * np.clip(-c, 0.0, 1.0) * np.abs(np.cos(TAU * u)) + 0.012 * _lumps(u, t / np.pi, 2.0)
    seam = 1.0 - 0.040 * (np.exp(-(((u - 0.75) / 0.016) ** 2)) + np.exp(-(((u - 0.25) / 0.016) ** 2))) * s
    ball = np.stack([0.365 * s * np.cos(TAU * u), 0.325 * s * np.sin(TAU * u), 0.335 * c + 0.0 * u], axis=-1)
    ball[..., :2] *= (cheeks * seam)[..., None]
    for side in (-1, 1):  # sockets pulled in by the eyes' threads
        far = np.linalg.norm(ball - (0.145 * side, -0.285, 0.065), axis=-1)
        ball[..., 1] += 0.030 * np.exp(-((far / 0.075) ** 2))
    skull = Skin(_turned(ball) + HEAD)
    skull.build("head", cloths["felt"], (2.2, 1.0))
    for at, start, end, count in ((0.75, 0.66, 0.95, 10), (0.25, 0.14, 0.95, 22)):
        skull.seam("head seam", np.full(count, at), np.linspace(start, end, count), 0.024, 0.3, cloths["dark"])
    skull.patch("head patch", (0.09, 0.66), (0.085, 0.075), 0.35, cloths["check"], cloths["thread"])

    shape = [(0.02, 0.0, 0.0, 0.150, 0.125), (0.10, 0.0, 0.0, 0.162, 0.134), (0.17, 0.0, 0.004, 0.156, 0.128),
             (0.225, 0.0, 0.012, 0.135, 0.112), (0.26, 0.0, 0.02, 0.10, 0.084), (0.282, 0.0, 0.024, 0.055, 0.047),
             (0.288, 0.0, 0.026, 0.012, 0.010)]  # fmt: skip
    axes = _turned(np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])).T
    root = _turned(np.array((0.0, -0.19, -0.10))) + HEAD
    muzzle = Skin(_rings(shape, 11, 26, axes, 1.0, 0.02) + root)
    muzzle.build("muzzle", cloths["pale"], (1.0, 0.3))
    u = np.linspace(0.0, 1.0, 26, endpoint=False)
    (a, up), (b, _) = muzzle.at(u, np.full(26, 0.30), 0.004), muzzle.at(u + 0.012, np.full(26, 0.11), 0.006)
    stitches("muzzle stitches", a, b, up, 0.013, cloths["dark"])
    _face(cloths, muzzle)

    rim = [(0.5, -0.050), (0.80, -0.048), (0.97, -0.028), (1.0, 0.0), (0.98, 0.022), (0.90, 0.032), (0.80, 0.026)]
    bowl = [(0.76, -0.012), (0.78, 0.030), (0.70, 0.022), (0.48, 0.010), (0.15, 0.004)]
    for side in (-1, 1):
        frame = _facing((0.42 * side, -1.0, 0.12))
        centre = _turned(np.array((0.255 * side, 0.02, 0.265))) + HEAD
        pad("ear", frame, centre, (0.148, 0.152), [*rim, (0.60, 0.012), (0.1, 0.0)], cloths["felt"], 24)
        pad("inner ear", frame, centre + 0.004 * frame[:, 2], (0.148, 0.152), bowl, cloths["cream" if side > 0 else "gingham"], 22)
        angle = np.linspace(-0.5, np.pi + 0.5, 15)
        flat = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ (frame[:, :2] * (0.148, 0.152)).T
        outer, inner = centre + 0.92 * flat + 0.033 * frame[:, 2], centre + 0.72 * flat + 0.026 * frame[:, 2]
        stitches("ear stitches", outer, inner, np.tile(frame[:, 2], (15, 1)), 0.012, cloths["thread"])


def _button(
    name: str,
    frame: np.ndarray,
    centre: np.ndarray,
    radius: float,
    profile: list[tuple[float, float]],
    height: float,
    paint: bpy.types.Material,
    thread: bpy.types.Material,
) -> None:
    """Button sewn on with a cross of thread, `height` above its centre."""
    pad(name, frame, centre, (radius, radius), profile, paint, 18)
    corners = centre + height * frame[:, 2] + 0.019 * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) @ frame[:, :2].T
    stitches(f"{name} threads", corners[:2], corners[2:], np.tile(frame[:, 2], (2, 1)), 0.011, thread)


def _claw(name: str, limb: Skin, u: float, v: tuple[float, float], thread: bpy.types.Material) -> None:
    """Thread laid along a limb at `u`, between two v."""
    path, _ = limb.at(np.full(5, u), np.linspace(*v, 5), 0.003 + 0.004 * np.array((-1.5, 1.0, 1.0, 1.0, -1.5)))
    tube_along_curve(name, path, np.full(5, 0.0085), thread, 5)


def _face(cloths: Colours, muzzle: Skin) -> None:
    """Buttons for eyes, a nose of silk, a mouth of three threads."""
    black = paints.button("black button", (0.034, 0.032, 0.032), (0.050, 0.044, 0.042), 0.15, 0.26)
    dome = [(0.6, -0.022), (0.95, -0.012), (1.03, 0.004), (0.98, 0.013), (0.90, 0.012), (0.84, 0.017), (0.62, 0.029), (0.15, 0.035)]
    for side in (-1, 1):
        frame = _facing((0.42 * side, -1.0, 0.16))
        centre = _turned(np.array((0.142 * side, -0.276, 0.068))) + HEAD
        _button("eye", frame, centre, 0.056, dome, 0.036, black, cloths["thread"])
    frame = _facing((0.0, -1.0, 0.42))
    angle = np.linspace(0.0, TAU, 22, endpoint=False)
    outline = 1.0 - 0.14 * np.sin(3.0 * angle) - 0.05 * np.cos(2.0 * angle)  # a corner below
    middle = _turned(np.array((0.0, -0.448, -0.035))) + HEAD
    cushion = [(0.8, -0.04), (1.0, -0.012), (1.0, 0.004), (0.88, 0.016), (0.6, 0.024), (0.2, 0.028)]
    pad("nose", frame, middle, (0.068, 0.050), cushion, paints.embroidery(), 22, outline)
    u_down = 0.75
    v = np.linspace(0.97, 0.78, 7)
    path, _ = muzzle.at(np.full(7, u_down), v, 0.003)
    tube_along_curve("mouth", path, np.full(7, 0.0085), cloths["dark"], 6)
    for side in (-1, 1):
        s = np.linspace(0.0, 1.0, 9)
        path, _ = muzzle.at(u_down + 0.17 * side * s, 0.78 - 0.10 * np.sin(np.pi * s**0.8) + 0.02 * s, 0.003)
        tube_along_curve("mouth", path, np.full(9, 0.0085), cloths["dark"], 6)


# ---------------------------------------------------------------- limbs
def _tube(path: np.ndarray, radii: np.ndarray, columns: int, seed: float) -> Skin:
    """Stuffed limb along a path (n, 3) of radii (n,)."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, (0.0, 1.0, 0.2))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(tangent, side)
    u, v = np.linspace(0.0, 1.0, columns, endpoint=False), np.linspace(0.0, 1.0, len(path))[:, None]
    r = radii[:, None] * (1.0 + 0.035 * _lumps(u, v, seed))
    across, upward = (r * np.cos(TAU * u))[..., None], (r * np.sin(TAU * u))[..., None]
    return Skin(path[:, None] + across * side[:, None] + upward * other[:, None])


def _arms(cloths: Colours) -> None:
    """Arms of felt on wooden buttons, hands in the lap, claws of thread."""
    wooden = paints.button("wooden button", (0.34, 0.16, 0.065), (0.20, 0.085, 0.036), 0.26, 0.48)
    face = [(0.7, -0.03), (1.0, -0.012), (1.0, 0.006), (0.90, 0.014), (0.72, 0.008), (0.15, 0.008)]
    share = np.concatenate([[0.0, 0.012, 0.05], np.linspace(0.12, 0.88, 12), [0.95, 0.985, 1.0]])
    for side in (-1, 1):
        lower = 0.03 if side > 0 else 0.0
        line = np.array([(0.20, 0.02, 0.03), (0.36, -0.03, -0.06), (0.455, -0.11, -0.20), (0.455, -0.27, -0.345 - lower),
                         (0.385, -0.43, -0.37 - 1.5 * lower)]) * (side, 1, 1)  # fmt: skip
        fine = smooth_path(line, 200)
        path = fine[np.round(share * 199).astype(int)]
        knots = (0.0, 0.012, 0.05, 0.15, 0.5, 0.8, 0.95, 0.985, 1.0)
        radii = np.interp(share, knots, (0.02, 0.06, 0.095, 0.118, 0.112, 0.108, 0.082, 0.050, 0.012))
        arm = _tube(path, radii, 20, 3.0 + side)
        arm.build("arm", cloths["felt"], (0.7, 0.9))
        count = 16
        arm.seam("arm seam", np.full(count, 0.30 if side > 0 else 0.20), np.linspace(0.22, 0.86, count), 0.020, 0.3, cloths["dark"])
        if side > 0:
            arm.patch("elbow patch", (0.02, 0.50), (0.085, 0.080), 0.5, cloths["navy"], cloths["thread"])
        else:
            arm.patch("sleeve patch", (0.53, 0.47), (0.090, 0.105), -0.2, cloths["gingham"], cloths["dark"])
        for k in (-1, 0, 1):  # claws
            _claw("claw", arm, arm.facing((0.5 * side, -0.4, 1.0), 0.88) + 0.075 * k, (0.80, 0.93), cloths["dark"])
        at = np.array(arm.facing((1.0 * side, -0.25, 0.1), 0.22)), np.array(0.22)
        shoulder, out = arm.at(*at, 0.004)
        right = np.cross((0.0, 0.0, 1.0), out) / np.hypot(out[0], out[1])
        frame = np.stack([right, np.cross(out, right), out], axis=1)
        _button("joint button", frame, shoulder, 0.052, face, 0.010, wooden, cloths["thread"])


def _legs(cloths: Colours) -> None:
    """Legs stretched out before the body, one of felt and one of calico, with soles of other cloths and toes of thread."""
    axes = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)]).T
    sections = [(-0.08, 0.17, -0.60, 0.02, 0.02), (-0.075, 0.17, -0.60, 0.09, 0.09), (0.0, 0.19, -0.61, 0.150, 0.145),
                (0.12, 0.225, -0.62, 0.158, 0.150), (0.25, 0.262, -0.63, 0.148, 0.138), (0.35, 0.287, -0.625, 0.136, 0.134),
                (0.41, 0.298, -0.605, 0.138, 0.156), (0.455, 0.304, -0.588, 0.143, 0.176), (0.505, 0.308, -0.584, 0.138, 0.174),
                (0.53, 0.310, -0.584, 0.122, 0.158), (0.537, 0.310, -0.584, 0.085, 0.115),
                (0.538, 0.310, -0.584, 0.03, 0.04)]  # fmt: skip
    for side in (-1, 1):
        placed = [(h, side * x, z + (0.012 if side < 0 else 0.0), a, b) for h, x, z, a, b in sections]
        leg = Skin(_rings(placed, 22, 24, axes, 5.0 + side, 0.025))
        leg.build("leg", cloths["felt" if side > 0 else "navy"], (0.85, 0.75))
        yarn = cloths["dark" if side > 0 else "thread"]
        leg.seam("leg seam", np.full(13, 0.25), np.linspace(0.28, 0.68, 13), 0.020, 0.3, yarn)
        sole = np.array((side * 0.310, -0.540, -0.584 + (0.012 if side < 0 else 0.0)))
        egg = 1.0 + 0.08 * np.sin(np.linspace(0.0, TAU, 24, endpoint=False))
        face = [(0.98, -0.02), (1.0, 0.002), (0.97, 0.008), (0.86, 0.011), (0.5, 0.014), (0.12, 0.015)]
        pad("sole", axes, sole, (0.094, 0.132), face, cloths["ticking" if side > 0 else "pale"], 24, egg)
        angle = np.linspace(0.0, TAU, 24, endpoint=False)
        flat = (egg[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)) @ (axes[:, :2] * (0.094, 0.132)).T
        up = np.tile(axes[:, 2], (24, 1))
        stitches("sole stitches", sole + 1.10 * flat + 0.002 * up, sole + 0.84 * flat + 0.012 * up, up, 0.013, cloths["red"])
        for k in (-1.5, -0.5, 0.5, 1.5):
            _claw("toe", leg, 0.25 + 0.045 * k, (0.70, 0.86), cloths["dark"])
        if side > 0:
            leg.patch("knee patch", (0.16, 0.40), (0.090, 0.085), 0.4, cloths["check"], cloths["red"])


# ---------------------------------------------------------------- bow
def _bow(torso: Skin, satin: bpy.types.Material) -> None:
    """Ribbon round the neck, two loops, a knot, and two tails that lie on the body."""
    angle = np.linspace(0.0, TAU * 1.04, 43)[:, None] + np.pi / 2  # its ends overlap behind
    height = np.array([-0.045, -0.025, 0.0, 0.025, 0.045])
    radius = 0.234 - 0.10 * np.abs(height) + 0.006 * np.sin(3 * angle) + 0.003 * np.sin(7 * angle + 30 * height)
    radius = radius + 0.012 * np.linspace(0.0, 1.0, 43)[:, None] ** 20
    level = NECK + height + 0.012 * np.sin(angle + 0.4)
    strip("neck ribbon", np.stack([radius * np.cos(angle), radius * np.sin(angle), level], axis=-1)[:, ::-1], satin, 0.012)
    where = -np.pi / 2 + 0.50
    out = np.array((np.cos(where), np.sin(where), -0.12))
    side = np.array((-np.sin(where), np.cos(where), 0.0))
    up = np.cross(out, side)
    origin = 0.250 * out + (0.0, 0.0, NECK)
    across = np.linspace(-1.0, 1.0, 5)
    w = np.linspace(0.0, 1.0, 19)[:, None]
    full = np.sin(np.pi * w)
    for hand in (-1.0, 1.0):
        reach = (0.26 if hand > 0 else 0.235) * full**0.9
        depth = 0.015 + 0.045 * full + hand * 0.060 * np.sin(TAU * w) * full**0.3 + 0.010 * np.cos(4.7 * across) * (1.0 - full)
        half = (0.026 + 0.060 * full**0.8) * across
        rise = (0.03 if hand > 0 else -0.035) * full**1.5 + half * (1.0 + 0.12 * full * across)
        points = origin + hand * reach[..., None] * side + depth[..., None] * out + rise[..., None] * up
        strip("loop", points, satin, 0.010)
        v = np.linspace(0.0, 1.0, 17)[:, None] * (1.0 - 0.13 * (1.0 - np.abs(across)))
        broad = (0.016 + 0.030 * np.clip(3.0 * v, 0.0, 1.0)) * (1.0 - 0.35 * v)
        u = where / TAU + 0.025 * hand + 0.115 * hand * v**1.1 + across * broad
        ripple = 0.013 * (1.0 + np.sin(13.0 * v + 1.4 * hand + 0.9 * across)) * np.clip(v / 0.3, 0.0, 1.0)
        lift = 0.020 + 0.055 * (1.0 - v) ** 3 + ripple
        points, _ = torso.at(u, 0.885 - (0.36 if hand > 0 else 0.30) * v, lift)
        strip("tail", points, satin, 0.010)
    heights = np.array([-0.058, -0.050, -0.03, 0.0, 0.03, 0.050, 0.058])
    bulge = np.array([0.45, 0.85, 1.02, 1.0, 1.02, 0.85, 0.45])[:, None]
    turn = np.linspace(0.0, TAU, 16, endpoint=False)
    ring = bulge * (1.0 + 0.08 * np.cos(5.0 * turn))
    knot = origin + 0.028 * out + (0.044 * ring * np.cos(turn))[..., None] * side - (0.046 * ring * np.sin(turn))[..., None] * out
    chart = np.stack(np.meshgrid(np.linspace(0.0, 0.5, 17), 0.6 * heights / 0.058) + [np.zeros((7, 17))], axis=-1)
    grid_surface("knot", knot + heights[:, None, None] * up, satin, chart)
