"""The figurine's clothes from the shoulders down: bodice, gathered overdress, pleated skirt, petticoat, shoes."""

from __future__ import annotations

import bpy
import numpy as np

from .figurine_form import TAU, blob, bump, circle, ellipses, ring
from .forms import grid_surface, tube_along_curve

SKIRT_DEPTHS = (1.0, 0.965, 0.93, 0.86, 0.76, 0.65, 0.53, 0.40, 0.26, 0.12)  # rows from hem to top
GRIP_ANGLE = np.radians(-136.0)  # where her right hand gathers the overdress
LIFT_ANGLE = np.radians(-128.0)  # where the skirt is raised over the shoes


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
        fold = np.sin(TAU * 3.4 * level + 0.4 * np.sin(3 * angle)) * droop**0.5 * np.clip(6 * (1.0 - s) - 0.6, 0, 1) * s**0.5
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
