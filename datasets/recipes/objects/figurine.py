"""Glazed porcelain figurine: a dancing lady lifting her skirt, with a plumed hat and a fan, on a rococo base.

She faces -y; her left hand is at +x. The pleats of the skirt are folded over (seen from above, a meander), so that
hard light casts shadows of one fold on the next, while glaze and pigment pooled in the troughs imitate them.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import figurine_paint as paints
from .common import grid_surface, sheet, smooth_path, tube_along_curve

TAU = 2.0 * np.pi


def turn_about(axis: int, degrees: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


HEAD_CENTRE = np.array([0.012, -0.02, 0.665])
HEAD_TURN = turn_about(2, 16.0) @ turn_about(1, 7.0) @ turn_about(0, 5.0)
HAT_TURN = HEAD_TURN @ turn_about(1, 14.0) @ turn_about(0, -14.0)
FAN_PIVOT = np.array([0.435, -0.17, 0.47])
SKIRT_DEPTHS = (1.0, 0.965, 0.93, 0.86, 0.76, 0.65, 0.53, 0.40, 0.26, 0.12)  # rows from hem to top
GRIP_ANGLE = np.radians(-136.0)  # where her right hand gathers the overdress
LIFT_ANGLE = np.radians(-128.0)  # where the skirt is raised over the shoes


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


def ring(columns: int) -> np.ndarray:
    """Angles of a ring, counter-clockwise about +z."""
    return np.linspace(0.0, TAU, columns, endpoint=False)


def bump(angle: np.ndarray, centre: float, width: float) -> np.ndarray:
    """Gaussian of the angular distance from `centre`."""
    return np.exp(-((np.angle(np.exp(1j * (angle - centre))) / width) ** 2))


def circle(
    radius: np.ndarray | float, angle: np.ndarray, z: np.ndarray | float, depth: float = 1.0, y: float = 0.0
) -> np.ndarray:
    """Ring of points (columns, 3) at the angles given, its y radius `depth` times its x radius, about (0, y, z)."""
    return np.stack([radius * np.cos(angle), depth * radius * np.sin(angle) + y, z + 0.0 * angle], axis=1)


def sphere(polar: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) from the angle to +z and the angle about it."""
    return np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=-1)


def ellipses(profile: list[tuple[float, ...]], columns: int) -> np.ndarray:
    """Rings from rows (x radius, y radius, z, y offset)."""
    return np.array([circle(a, ring(columns), z, b / a, y) for a, b, z, y in profile])


def pleats(columns: int, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ring of the underskirt (columns, 3) at `depth` 0 (top) to 1 (hem), its fold height in [-1, 1], its angles.

    In the phase p of the pleats the ring is (p + k sin 2p, cos p): it folds over itself where k > 1/2.
    """
    angle = ring(columns)
    phase = 13 * angle + 0.7 * np.sin(2 * angle + 0.6) + 0.5 * np.sin(5 * angle + 2.0)
    height = np.cos(phase) * (1.0 + 0.25 * np.sin(3 * angle + 1.0) + 0.15 * np.sin(7 * angle + 4.0))
    lifted = depth**2 * bump(angle, LIFT_ANGLE, 0.42)
    radius = 0.27 + 0.27 * depth**0.75 + (0.010 + 0.082 * depth**1.1) * height + 0.05 * lifted
    turned = angle + (0.30 + 0.42 * depth) * np.sin(2 * phase) / 13 - 0.32 * depth**2
    z = -0.02 - 0.64 * depth + 0.13 * lifted - 0.012 * height * depth**3
    return circle(radius, turned, z), height / 1.4, angle


def underskirt(paint: bpy.types.Material) -> None:
    """Pleated skirt with a hem of real thickness and a shallow hollow beneath."""
    columns = 156
    hem, fold, angle = pleats(columns, 1.0)
    tangent = np.roll(hem, -1, axis=0) - np.roll(hem, 1, axis=0)
    inward = np.stack([-tangent[:, 1], tangent[:, 0], 0 * fold], axis=1)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    hollow = circle(0.36, angle - 0.32, -0.50)
    rows = [hollow, hem + 0.016 * inward + (0, 0, 0.012), hem + 0.008 * inward - (0, 0, 0.010)]
    heights = [-0.10, -0.02, -0.005]
    for depth in SKIRT_DEPTHS:
        rows.append(pleats(columns, depth)[0])
        heights.append(0.75 * (1.0 - depth))
    chart = np.empty((len(rows), columns + 1, 3))
    steps = np.linalg.norm(hem - np.roll(hem, 1, axis=0), axis=1)
    chart[..., 0] = np.append(np.cumsum(steps) - steps[0], np.sum(steps))
    chart[..., 1] = np.array(heights)[:, None]
    chart[..., 2] = np.append(fold, fold[0])
    grid_surface("underskirt", np.array(rows), paint, chart)


def polonaise(paint: bpy.types.Material) -> None:
    """Overdress gathered at six points: festoons with draped folds, puffed, with a ruffled edge that curls under."""
    columns = 128
    angle = ring(columns)
    festoon = (3 * (angle + np.pi / 2) / np.pi + 0.5) % 1.0
    droop = 4 * festoon * (1 - festoon)
    pulled = bump(angle, LIFT_ANGLE - 0.25, 0.30)
    edge_r, edge_z = 0.395 + 0.055 * droop + 0.03 * pulled, -0.06 - 0.20 * droop + 0.05 * pulled
    ruffle = np.cos(32 * angle)
    rows = [circle(edge_r - 0.075, angle, edge_z + 0.06, 0.94)]
    rows.append(circle(edge_r - 0.005 + 0.006 * ruffle, angle, edge_z - 0.004, 0.94))
    heights, folds = [-0.03, -0.003], [0 * angle, 0 * angle]
    for up in (0.004, 0.034, 0.062, 0.085, 0.12, 0.16, 0.20, 0.25, 0.31, 0.39, 0.49):
        s = 1.0 - up / 0.52
        level = s + 0.30 * (1.0 - droop)
        fold = (
            np.sin(TAU * 3.4 * level + 0.4 * np.sin(3 * angle))
            * droop**0.5
            * np.clip(6 * (1.0 - s) - 0.6, 0, 1)
            * s**0.5
        )
        fold += 0.6 * np.cos(32 * angle) * np.clip(1.4 - 2 * s, 0, 1) * min(1.0, 4 * s)
        puff = 0.060 * np.sin(np.pi * np.clip(s, 0, 1) ** 1.6) * (0.35 + 0.65 * droop)
        flare = 0.020 * max(0.0, 1.0 - up / 0.06)
        crimp = 0.016 * ruffle * max(0.0, 1.0 - up / 0.07)
        r = 0.09 + (edge_r - 0.09) * s**0.62 + puff + flare + crimp + 0.020 * fold
        pinch = bump(angle, GRIP_ANGLE, 0.17) * np.exp(-(((s - 0.60) / 0.22) ** 2))  # gathered in her right hand
        r = r + 0.035 * pinch
        z = 0.165 + (edge_z - 0.165) * s**1.35 + 0.5 * puff + 0.014 * fold + 0.045 * pinch
        rows.append(circle(r, angle, z, 0.94))
        heights.append(up)
        folds.append(fold)
    chart = np.empty((len(rows), columns + 1, 3))
    chart[..., 0] = np.linspace(0.0, 2.7, columns + 1)
    chart[..., 1] = np.array(heights)[:, None]
    chart[..., 2] = np.concatenate([np.array(folds), np.array(folds)[:, :1]], axis=1)
    grid_surface("polonaise", np.array(rows), paint, chart)


def petticoat(lace: bpy.types.Material) -> None:
    """Lace petticoat that carries the skirt."""
    angle = ring(54)
    rows = []
    for r, z, ripple in ((0.40, -0.695, 0.022), (0.425, -0.672, 0.03), (0.39, -0.62, 0.018), (0.33, -0.51, 0.008)):
        radius = r + ripple * np.cos(18 * angle)
        rows.append(circle(radius, angle, z))
    grid_surface("petticoat", np.array(rows), lace)


def shoes(leather: bpy.types.Material, gold: bpy.types.Material) -> None:
    """Two slippers peeping out below the lifted hem, each with a gold buckle."""
    for angle, reach in ((LIFT_ANGLE - 0.12, 0.56), (LIFT_ANGLE + 0.24, 0.53)):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        path = np.outer(np.linspace(0.36, reach, 9), out) + (0, 0, -0.655)
        radii = np.array([0.030, 0.034, 0.037, 0.039, 0.039, 0.036, 0.030, 0.020, 0.007])
        path[:, 2] += radii - 0.037
        tube_along_curve("shoe", path, radii, leather, 9, 0.9)
        blob("buckle", out * (reach - 0.07) + (0, 0, -0.617), (0.012, 0.012, 0.009), gold)


def blob(name: str, centre: np.ndarray, radii: tuple[float, float, float], paint: bpy.types.Material) -> None:
    """Small ellipsoid."""
    polar = np.linspace(0.92, 0.08, 5) * np.pi
    p, a = np.meshgrid(polar, ring(8), indexing="ij")
    grid_surface(name, sphere(p, a) * radii + centre, paint)


def bodice(cloth: bpy.types.Material, skin: bpy.types.Material) -> None:
    """Stiff bodice, and shoulders and neck rising out of it."""
    waist = [
        (0.088, 0.075, 0.11, 0.0),
        (0.086, 0.073, 0.16, 0.0),
        (0.098, 0.080, 0.21, -0.002),
        (0.118, 0.092, 0.28, -0.008),
    ]
    bust = [
        (0.133, 0.104, 0.34, -0.014),
        (0.136, 0.104, 0.38, -0.013),
        (0.137, 0.098, 0.405, -0.008),
        (0.143, 0.098, 0.418, -0.006),
    ]
    points = ellipses([*waist, *bust, (0.133, 0.088, 0.420, -0.004), (0.128, 0.083, 0.410, -0.003)], 26)
    grid_surface("bodice", points, cloth)
    chest = [
        (0.128, 0.082, 0.395, -0.006),
        (0.132, 0.079, 0.425, -0.002),
        (0.122, 0.066, 0.455, 0.004),
        (0.085, 0.052, 0.478, 0.008),
    ]
    neck = [
        (0.052, 0.046, 0.497, 0.006),
        (0.042, 0.043, 0.525, 0.0),
        (0.040, 0.042, 0.56, -0.006),
        (0.040, 0.042, 0.60, -0.012),
    ]
    points = ellipses([*chest, *neck], 24)
    points[:3, :, 1] -= 0.012 * (bump(ring(24), -2.05, 0.35) + bump(ring(24), -1.09, 0.35))
    grid_surface("shoulders", points, skin)


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
        wave = max(0.0, r - 0.09) * (
            0.22 * np.cos(2 * angle + 0.5) + 0.16 * np.cos(3 * angle + 2.0) + 0.10 * np.cos(5 * angle)
        )
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


def arms(
    skin: bpy.types.Material, cloth: bpy.types.Material, lace: bpy.types.Material, gold: bpy.types.Material
) -> None:
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
