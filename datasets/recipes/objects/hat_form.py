"""Form of the straw hat: one smooth surface over (arc length, angle), and meshes on it that carry coordinates for paint."""

from __future__ import annotations

import bpy
import numpy as np

from .forms import cells, mesh_object, store_chart, tube

PITCH = 0.0535  # width of one turn of the braid
EYE = 0.02  # radius at which the spiral starts
TURNS = 22  # of the braid, from the top of the crown to the rim
RIM = EYE + PITCH * TURNS  # arc length from the top of the crown to the rim

# Section of the hat without waves: (radius, height) from the top of the crown to the brim.
SECTION = np.array([
    (0.00, 0.435), (0.10, 0.434), (0.20, 0.428), (0.27, 0.408), (0.318, 0.37), (0.345, 0.31), (0.362, 0.23),
    (0.376, 0.14), (0.390, 0.065), (0.412, 0.022), (0.455, 0.002), (0.55, -0.012), (0.70, -0.030),
    (0.85, -0.050), (1.05, -0.070),
])  # fmt: skip


def _fine_section() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arc length, radius and height along the rounded section."""
    points = SECTION
    for _ in range(4):  # corner cutting (Chaikin), which keeps the ends
        inner = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], inner.reshape(-1, 2), points[-1:]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return length, points[:, 0], points[:, 1]


ARC, RADIUS, HEIGHT = _fine_section()
BAND_MIDDLE = float(ARC[np.argmax((HEIGHT < 0.105) & (RADIUS > 0.3))])  # arc length at the ribbon's middle line
OPENING = float(ARC[np.argmax((HEIGHT < 0.055) & (RADIUS > 0.3))])  # where the lining of straw starts inside the crown


# ---------------------------------------------------------------- the shape of the hat
def bare(arc: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the smooth hat at an arc length from the crown's top and an angle."""
    radius, height = np.interp(arc, ARC, RADIUS), np.interp(arc, ARC, HEIGHT)
    outward = np.clip((radius - 0.43) / 0.50, 0.0, None)  # 0 at the crown, 1 at the rim
    oval = 0.06 * np.exp(-2.0 * outward)  # heads are longer than wide, the rim is round
    x, y = radius * np.cos(angle) * (1.0 + oval), radius * np.sin(angle) * (1.0 - oval)
    wave = 0.052 * np.cos(2.0 * angle - 0.5) + 0.034 * np.cos(3.0 * angle + 1.3) + 0.012 * np.sin(5.0 * angle + 0.4)
    crease = 0.075 * np.exp(-((x / 0.24) ** 2) - (y / 0.10) ** 2) * (height > 0.3)  # pinched by the hand that lifts it
    return np.stack([x, y, height + wave * outward**1.5 - crease], axis=-1)


def surface(arc: np.ndarray, angle: np.ndarray, lift: np.ndarray | float = 0.0) -> np.ndarray:
    """Points lifted off the smooth hat along its outward normal."""
    arc, angle = np.broadcast_arrays(np.asarray(arc, float), np.asarray(angle, float))
    step = 1e-3
    start = np.maximum(arc, 2.0 * step)  # the angle has no direction at the very top
    down = bare(start + step, angle) - bare(start - step, angle)
    round_ = bare(start, angle + step) - bare(start, angle - step)
    normal = np.cross(down, round_)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return bare(arc, angle) + np.asarray(lift)[..., None] * normal


def brim_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the smooth brim over points of the plane, by fixed-point inversion of `bare`."""
    arc, angle = np.interp(np.hypot(x, y), RADIUS, ARC), np.arctan2(y, x)
    for _ in range(12):
        found = bare(arc, angle)
        arc = arc + np.hypot(x, y) - np.hypot(found[..., 0], found[..., 1])
        angle = angle + np.arctan2(y, x) - np.arctan2(found[..., 1], found[..., 0])
    return bare(arc, angle)[..., 2]


def worn(points: np.ndarray) -> np.ndarray:
    """Tilt the hat to its resting pose on the block."""
    roll, pitch = np.radians(9.0), np.radians(-7.0)
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    return points @ (about_x @ about_y).T + (0.0, 0.0, 0.11)


# ---------------------------------------------------------------- meshes with a chart
def charted(
    name: str, points: np.ndarray, faces: list[list[int]], charts: list[list], paint: bpy.types.Material, sharp: float
) -> bpy.types.Object:
    """Object in the hat's pose, with one chart triple per face corner."""
    item = mesh_object(name, worn(points), faces, paint, sharp)
    store_chart(item, np.concatenate(charts))
    return item


def skin(
    name: str,
    points: np.ndarray,
    chart: np.ndarray,
    paint: bpy.types.Material,
    *,
    caps: bool = True,
    sharp: float = 40.0,
) -> bpy.types.Object:
    """Surface through closed rings: `points` (rows, columns, 3), `chart` (rows, columns + 1, 3), flat end caps."""
    rows, columns, _ = points.shape
    faces, charts = tube(rows, columns), [*cells(chart)]
    if caps:
        for j in range(columns // 2 - 1):  # strips between the two halves of the ring
            strip = [j, j + 1, columns - 2 - j, columns - 1 - j]
            faces += [strip[::-1], [(rows - 1) * columns + index for index in strip]]
            charts += [chart[0, strip[::-1]], chart[-1, strip]]
    return charted(name, points.reshape(-1, 3), faces, charts, paint, sharp)


def ribbon_strip(
    name: str, points: np.ndarray, paint: bpy.types.Material, wide: np.ndarray, thickness: float = 0.010
) -> bpy.types.Object:
    """Solid strip round a sheet (along, across, 3), with the chart (length, distance from the middle, 0).

    `wide` holds that distance per column, so that a gathered strip carries the whole width of the print.
    """
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal *= 0.5 * thickness / np.linalg.norm(normal, axis=-1, keepdims=True)
    rings = np.concatenate([points - normal, (points + normal)[:, ::-1]], axis=1)
    middle = points[:, points.shape[1] // 2]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    across = np.concatenate([wide, wide[::-1], wide[:1]])
    chart = np.stack([*np.meshgrid(along, across, indexing="ij"), np.zeros((len(along), len(across)))], axis=-1)
    return skin(name, rings, chart, paint)
