"""Glazed porcelain figurine: a dancing lady lifting her skirt, with a plumed hat and a fan, on a rococo base.

She faces -y; her left hand is at +x. The pleats of the skirt are folded over (seen from above, a meander), so that
hard light casts shadows of one fold on the next, while glaze and pigment pooled in the troughs imitate them.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import figurine_paint as paints
from .figurine_dress import bodice, petticoat, polonaise, shoes, underskirt
from .figurine_form import TAU, blob, circle, ring, sphere, turn_about
from .forms import grid_surface, sheet, smooth_path, tube_along_curve

HEAD_CENTRE = np.array([0.012, -0.02, 0.665])
HEAD_TURN = turn_about(2, 16.0) @ turn_about(1, 7.0) @ turn_about(0, 5.0)
HAT_TURN = HEAD_TURN @ turn_about(1, 14.0) @ turn_about(0, -14.0)
FAN_PIVOT = np.array([0.435, -0.17, 0.47])


def build() -> None:
    """Build the figurine in the current scene."""
    gold = paints.gilt()
    lace = paints.lace_paint()
    skin = paints.bisque()
    leaf = paints.glazed("leaf", (0.10, 0.24, 0.07), (0.22, 0.34, 0.10))
    blooms = [paints.rose_paint("rose pink", (0.72, 0.20, 0.24)), paints.rose_paint("rose yellow", (0.80, 0.56, 0.14))]
    brocade = paints.brocade_paint()
    base(paints.base_paint(), gold)
    petticoat(lace)
    shoes(paints.glazed("shoe", (0.50, 0.08, 0.10), (0.36, 0.04, 0.07)), gold)
    underskirt(paints.skirt_paint())
    polonaise(brocade)
    bodice(paints.bodice_paint(), skin)
    head(paints.face_paint(HEAD_CENTRE, HEAD_TURN))
    hair(paints.hair_paint())
    hat(paints.hat_paint(), paints.plume_paint(), gold)
    arms(skin, brocade, lace, gold)
    fan(paints.fan_paint(FAN_PIVOT))
    flowers(blooms, leaf)


def head(paint: bpy.types.Material) -> None:
    """Doll's head: brow, nose, lips, chin and cheeks raised on an egg."""
    columns, rows = 36, 20
    azimuth = ring(columns) - np.pi / 2
    azimuth = azimuth - 0.45 * np.sin(azimuth + np.pi / 2)  # denser toward the face
    elevation = np.linspace(-0.48, 0.48, rows) * np.pi
    a, e = np.meshgrid(azimuth, elevation)
    points = sphere(np.pi / 2 - e, a) * (0.090, 0.100, 0.122)
    x, z = points[..., 0], points[..., 2]
    front = np.clip(-points[..., 1] / 0.05, 0, 1)

    def mound(cx: float, cz: float, wx: float, wz: float) -> np.ndarray:
        return front * np.exp(-(((np.abs(x) - cx) / wx) ** 2) - ((z - cz) / wz) ** 2)

    relief = 0.020 * mound(0, -0.018, 0.012, 0.014) + 0.010 * mound(0, 0.008, 0.009, 0.022)
    relief += 0.007 * mound(0, -0.054, 0.020, 0.010) + 0.010 * mound(0, -0.092, 0.024, 0.018)
    relief += 0.005 * mound(0.052, -0.025, 0.024, 0.024) + 0.004 * mound(0.034, 0.040, 0.024, 0.012)
    relief -= 0.009 * mound(0.034, 0.014, 0.018, 0.016) + 0.004 * mound(0, -0.072, 0.020, 0.008)
    jaw = 1.0 - 0.22 * np.clip(-z / 0.12, 0, 1)
    points[..., 1] = points[..., 1] - relief
    points[..., 0] *= jaw
    grid_surface("head", points @ HEAD_TURN.T + HEAD_CENTRE, paint)


def hair(paint: bpy.types.Material) -> None:
    """Brushed-back hair, a chignon, and ringlets behind the ears."""
    angle, polar = ring(54), np.linspace(0.66, 0.03, 9) * np.pi
    p, a = np.meshgrid(polar, angle, indexing="ij")
    cap = sphere(p, a)
    cap *= (1.0 + 0.03 * np.cos(18 * a) * np.sin(p) * (1.0 - (p / polar[0]) ** 6))[..., None]
    cap[0] *= 0.93
    cap = cap @ turn_about(0, -62.0).T * (0.101, 0.112, 0.132) + (0.0, 0.012, 0.008)
    grid_surface("hair", cap @ HEAD_TURN.T + HEAD_CENTRE, paint)
    bun = sphere(p, a + 2 * p)[::2, ::2]
    bun *= (0.062 * (1.0 + 0.10 * np.cos(8 * a)))[::2, ::2, None]
    grid_surface("chignon", (bun @ turn_about(0, -80.0).T + (0, 0.125, 0.01)) @ HEAD_TURN.T + HEAD_CENTRE, paint)
    s = np.linspace(0.0, 1.0, 18)
    for x, y, length in ((-0.085, 0.035, 0.20), (0.085, 0.035, 0.22), (-0.06, 0.085, 0.25), (0.06, 0.085, 0.23)):
        coil = circle(0.014, TAU * 3.0 * s, -length * s - 0.02)
        start = np.array([x, y, 0.0]) @ HEAD_TURN.T + HEAD_CENTRE
        tube_along_curve("ringlet", coil + start, 0.019 * np.sin(np.pi * (0.12 + 0.80 * s)) ** 0.6, paint, 6)


def hat(straw: bpy.types.Material, plume: bpy.types.Material, gold: bpy.types.Material) -> None:
    """Tilted wide-brimmed hat with two plumes and a gold brooch."""
    angle = ring(34)
    profile = (
        (0.06, 0.020),
        (0.10, 0.003),
        (0.15, -0.002),
        (0.186, -0.002),
        (0.194, 0.005),
        (0.187, 0.012),
        (0.15, 0.014),
    )
    crown = ((0.105, 0.018), (0.092, 0.030), (0.088, 0.055), (0.082, 0.078), (0.062, 0.090), (0.03, 0.094))
    rows = []
    for r, z in (*profile, *crown):
        wave = max(0.0, r - 0.09) * (0.22 * np.cos(2 * angle + 0.5) + 0.16 * np.cos(3 * angle + 2.0) + 0.10 * np.cos(5 * angle))
        rows.append(circle(r, angle, z + wave))
    centre = HEAD_CENTRE + HEAD_TURN @ np.array([0.008, 0.020, 0.090])
    grid_surface("hat", np.array(rows) @ HAT_TURN.T + centre, straw)
    s = np.linspace(0.0, 1.0, 18)
    for side, rise in ((0.03, 0.0), (-0.03, 0.045)):
        curl = [
            (-0.07, -0.06, 0.03),
            (-0.11, 0.02 + side, 0.10 + rise),
            (-0.06, 0.12 + side, 0.13 + rise),
            (0.0, 0.20, 0.07 + rise),
        ]
        curl.append((-0.01, 0.225, 0.0 + rise))
        width = 0.042 * np.sin(np.pi * (0.06 + 0.88 * s)) ** 0.7
        radii = width[:, None] * (1.0 + 0.14 * np.cos(np.pi * np.arange(18))[:, None] * np.abs(np.cos(ring(7)))[None])
        tube_along_curve("plume", smooth_path(curl, 18) @ HAT_TURN.T + centre, radii, plume, 7, 0.42)
    blob("brooch", HAT_TURN @ np.array([-0.072, -0.072, 0.035]) + centre, (0.018, 0.018, 0.018), gold)


def arms(skin: bpy.types.Material, cloth: bpy.types.Material, lace: bpy.types.Material, gold: bpy.types.Material) -> None:
    """Arms with fingers, puffed sleeves, lace cuffs and bracelets: the right holds the skirt, the left the fan."""
    right = [
        (-0.135, 0.0, 0.425),
        (-0.235, 0.03, 0.32),
        (-0.315, -0.02, 0.21),
        (-0.315, -0.16, 0.14),
        (-0.29, -0.30, 0.085),
    ]
    left = [(0.135, 0.0, 0.425), (0.245, 0.05, 0.34), (0.345, 0.02, 0.285), (0.40, -0.08, 0.36), (0.435, -0.165, 0.455)]
    for points, spread in ((right, (0.0, 0.0, -1.0)), (left, (0.5, 0.2, 0.8))):
        path = smooth_path(points, 19)
        s = np.linspace(0.0, 1.0, 19)
        radii = np.interp(s, (0, 0.5, 0.62, 0.88, 0.93, 1.0), (0.046, 0.036, 0.035, 0.020, 0.026, 0.016))
        tube_along_curve("arm", path[5:], radii[5:], skin, 9)
        forward = path[-1] - path[-3]
        forward /= np.linalg.norm(forward)
        across = np.cross(forward, spread)
        across /= np.linalg.norm(across)
        for k, reach in enumerate((0.050, 0.060, 0.060, 0.050)):
            root = path[-2] + across * 0.011 * (k - 1.5)
            tip = root + reach * forward + 0.2 * reach * across * (k - 1.5)
            bend = np.array(spread) * 0.022
            tube_along_curve(
                "finger", smooth_path([root, 0.5 * (root + tip), tip + bend], 5), np.linspace(0.0095, 0.006, 5), skin, 5
            )
        thumb = [path[-3], path[-3] + 0.026 * across + 0.01 * forward, path[-2] + 0.028 * across + 0.022 * forward]
        tube_along_curve("thumb", smooth_path(thumb, 5), np.linspace(0.010, 0.007, 5), skin, 5)
        around = ring(28)
        t = s[:10][::-1, None]  # from the elbow up, so that the trimmed edge of the cloth is at the elbow
        puff = np.interp(t, (0.0, 0.08, 0.22, 0.38, 0.46, 0.5), (0.05, 0.076, 0.086, 0.070, 0.050, 0.044))
        tube_along_curve("sleeve", path[9::-1], puff * (1 + 0.10 * np.cos(7 * around + 3.0 * t)), cloth, 28)
        cuff = np.linspace(0.0, 1.0, 5)
        flare = np.array([0.043, 0.060, 0.083, 0.088, 0.050])[:, None] * (1 + np.outer(0.20 * cuff, np.cos(7 * around)))
        steps = path[8] + np.array([0.0, 0.30, 0.72, 0.80, 0.83])[:, None] * (path[13] - path[8])
        tube_along_curve("cuff", steps, flare, lace, 28)
        tube_along_curve("bracelet", path[14:16], radii[14:16] + 0.006, gold, 12)


def fan(paint: bpy.types.Material) -> None:
    """Open pleated fan held up in the left hand."""
    spread = np.radians(np.linspace(-68.0, 68.0, 29))
    zigzag = np.where(np.arange(29) % 2 == 0, 1.0, -1.0)
    axis = np.array([0.62, -0.10, 0.78]) / np.linalg.norm((0.62, -0.10, 0.78))
    facing = np.cross(axis, (0.78, 0.35, -0.575))
    facing /= np.linalg.norm(facing)
    sideways = np.cross(facing, axis)
    rows = []
    for r in (0.02, 0.11, 0.18, 0.255):
        offset = (0.0055 * zigzag * r / 0.16 + 0.02 * np.cos(spread) * r / 0.25)[:, None] * facing
        rows.append(FAN_PIVOT + r * (np.outer(np.cos(spread), axis) + np.outer(np.sin(spread), sideways)) + offset)
    sheet("fan", np.array(rows), paint, 0.010, 25.0)


def rose(centre: np.ndarray, normal: np.ndarray, size: float, paint: bpy.types.Material) -> None:
    """Rose with spiralling petal rims, opening along `normal`."""
    up = normal / np.linalg.norm(normal)
    side = np.cross(up, (0.31, 0.52, 0.80))
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(up, side), up], axis=1)
    angle, polar = ring(10), np.linspace(0.70, 0.06, 7) * np.pi
    p, a = np.meshgrid(polar, angle, indexing="ij")
    radius = 1.0 + 0.15 * np.cos(4.0 * np.pi * p / polar[0] + a) + 0.12 * np.cos(5 * a + 4 * p) * np.sin(p)
    points = sphere(p, a) * (1.0, 1.0, 0.75) * radius[..., None]
    grid_surface("rose", size * points @ frame.T + centre, paint)


def foliage(root: np.ndarray, tip: np.ndarray, width: float, paint: bpy.types.Material) -> None:
    """Pointed leaf, arched upwards."""
    middle = 0.5 * (root + tip) + (0.0, 0.0, 0.25 * width)
    radii = width * np.array([0.3, 0.95, 0.9, 0.5, 0.06])
    tube_along_curve("leaf", smooth_path([root, middle, tip], 5), radii, paint, 4, 0.4)


def flowers(blooms: list[bpy.types.Material], leaf: bpy.types.Material) -> None:
    """Roses at the gathers of the overdress, on the bodice, on the hat and in bunches on the base."""
    for k in range(6):
        angle = -np.pi / 2 + TAU * (k + 0.5) / 6
        out = np.array([np.cos(angle), np.sin(angle), 0.35])
        rose(out * (0.435, 0.41, 0.0) + (0, 0, -0.03), out, 0.042, blooms[k % 2])
    rose(np.array([0.0, -0.115, 0.405]), np.array([0.0, -1.0, 0.4]), 0.028, blooms[0])
    for k, angle in enumerate((-0.9, -0.4, 0.15)):
        spot = np.array([0.102 * np.cos(angle), 0.102 * np.sin(angle), 0.125])
        rose(
            HEAD_CENTRE + HAT_TURN @ spot,
            HAT_TURN @ np.array([np.cos(angle), np.sin(angle), 0.9]),
            0.034,
            blooms[k % 2],
        )
    for centre in np.radians((-90.0, 54.0, 126.0)):
        for k, (turn, size, lift) in enumerate(((0.0, 0.052, 0.0), (0.16, 0.042, -0.01), (-0.15, 0.040, -0.012))):
            out = np.array([np.cos(centre + turn), np.sin(centre + turn), 0.0])
            rose(0.585 * out + (0, 0, -0.675 + lift), out + (0, 0, 0.9), size, blooms[k % 2])
        for turn in (-0.30, -0.07, 0.08, 0.30):
            root, tip = (
                np.array([r * np.cos(centre + f * turn), r * np.sin(centre + f * turn), 0.0])
                for r, f in ((0.56, 0.7), (0.635, 1.3))
            )
            foliage(root + (0, 0, -0.69), tip + (0, 0, -0.70), 0.026, leaf)


def base(paint: bpy.types.Material, gold: bpy.types.Material) -> None:
    """Lobed rococo base on a foot ring, hollowed below, with C-scrolls between the bunches of flowers."""
    angle = ring(60)
    lobes = 1.0 + 0.030 * np.cos(5 * angle - np.pi / 2) + 0.010 * np.cos(10 * angle)
    profile = ((0.10, -0.785), (0.40, -0.79), (0.45, -0.815), (0.485, -0.822), (0.51, -0.812), (0.505, -0.79))
    profile += ((0.52, -0.755), (0.562, -0.732), (0.578, -0.715), (0.565, -0.702), (0.52, -0.695), (0.36, -0.685))
    points = np.array([circle(r * lobes, angle, z) for r, z in profile])
    points[-2:, :, 2] += 0.008 * np.sin(17 * angle) * np.sin(5 * angle + 1.0)
    grid_surface("base", points, paint, sharp_deg=60.0)
    s = np.linspace(0.0, 1.0, 13)
    curl, radius = TAU * 1.3 * s, 0.046 * (1.0 - 0.78 * s)
    half = np.stack([0.095 + radius * np.sin(curl), -0.757 + radius * np.cos(curl)], axis=1)
    outline = np.concatenate([half[::-1] * (-1, 1), [(-0.05, -0.719), (0.0, -0.727), (0.05, -0.719)], half])
    across = np.abs(np.linspace(-1.0, 1.0, len(outline)))
    thickness = 0.013 + 0.028 * across * (1.0 - across)
    for station in np.radians((-54.0, 18.0, 90.0, 162.0, 234.0)):
        turned = station + outline[:, 0] / 0.57
        path = circle(0.578, turned, outline[:, 1])
        tube_along_curve("scroll", path, thickness, gold, 5)
