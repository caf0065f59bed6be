"""Random building blocks: every call draws another form of a family. All about unit half size, around the origin."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull
from skimage.measure import marching_cubes

from ia_bench_training.draws import log_uniform, rotation
from ia_bench_training.surfaces import Surface, displace, extrude, revolve, rounded_box, superquadric, sweep, weld


def circle(count: int, radius: float = 1.0) -> np.ndarray:
    """A regular polygon (count, 2)."""
    angle = np.arange(count) * (2 * math.pi / count)
    return radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def smooth_profile(rng: Generator, knots: int, points: int, low: float, high: float) -> np.ndarray:
    """Positive random radii along [0, 1], smooth: (points,)."""
    values = rng.uniform(low, high, knots)
    return CubicSpline(np.linspace(0, 1, knots), values)(np.linspace(0, 1, points)).clip(0.5 * low, 1.2 * high)


def box(rng: Generator) -> Surface:
    """A box of random proportions, sharp, bevelled or cushioned."""
    half = rng.uniform(0.25, 1, 3)
    half /= half.max()
    bevel = float(rng.choice([0.015, 0.05, 0.15, 0.5, 0.9])) * float(half.min())
    return rounded_box(half, bevel, 1 if bevel < 0.03 else 4)


def quadric(rng: Generator) -> Surface:
    """A superquadric: ball, pillow, barrel, lens, octahedron."""
    surface = superquadric(rng.choice([0.3, 0.6, 1.0, 1.0, 1.6]), rng.choice([0.3, 0.6, 1.0, 1.0, 1.6]), 36)
    return Surface(surface.vertices * rng.uniform(0.45, 1, 3), surface.faces)


def turned(rng: Generator) -> Surface:
    """Turned wood or metal: a solid of revolution with curves and ledges."""
    radius = smooth_profile(rng, int(rng.integers(3, 8)), 26, 0.15, 0.9)
    height = np.linspace(-1, 1, 26)
    if rng.random() < 0.5:  # ledges: radii in steps
        levels = rng.integers(3, 7)
        step = np.sort(rng.uniform(-0.95, 0.95, levels - 1))
        values = rng.uniform(0.2, 0.9, levels)
        edge = np.repeat(step, 2)
        height = np.concatenate([[-1], edge, [1]])
        radius = np.repeat(values, 2)
    profile = np.stack([np.concatenate([[0], radius, [0]]), np.concatenate([[height[0]], height, [height[-1]]])], -1)
    lobes = int(rng.choice([0, 0, 0, 5, 8, 12, 20]))
    return revolve(profile, 44, lobes=lobes, depth=rng.uniform(0.03, 0.15) if lobes else 0)


def vessel(rng: Generator) -> Surface:
    """A bowl, vase, cup or pot with a real inside, its wall of even thickness."""
    knots = int(rng.integers(3, 6))
    outer = smooth_profile(rng, knots, 24, 0.35, 1.0)
    height = np.linspace(-1, 1, 24) * rng.uniform(0.35, 1.2)
    wall = rng.uniform(0.04, 0.12)
    inner = np.maximum(outer - wall, 0.1)[::-1][:-3]
    inner_height = height[::-1][:-3]
    radius = np.concatenate([[0, outer[0] * 0.98], outer, inner, [0]])
    level = np.concatenate([[height[0], height[0]], height, inner_height, inner_height[-1:]])
    lobes = int(rng.choice([0, 0, 0, 0, 6, 10, 16]))
    profile = np.stack([radius, level], -1)
    return revolve(profile, 44, lobes=lobes, depth=rng.uniform(0.02, 0.1) if lobes else 0)


def ring(rng: Generator) -> Surface:
    """A torus, band or tyre."""
    size, flat = rng.uniform(0.06, 0.4), rng.uniform(0.4, 2.0)
    section = circle(14) * [size, size * flat]
    if rng.random() < 0.4:
        section = np.sign(section) * np.abs(section / size) ** 0.5 * size
    return revolve(section + [1 - size, 0], 48, closed=True)


def cone(rng: Generator) -> Surface:
    """A cone, truncated cone, pyramid or prism."""
    sides, top = int(rng.choice([3, 4, 5, 6, 8, 40, 40])), rng.choice([0.0, 0.02, rng.uniform(0.1, 0.9)])
    height = rng.uniform(0.4, 1.2)
    profile = np.array([[0, -1], [0.97, -1], [1, -0.97], [top + 0.02, 0.98], [top, 1], [0, 1]]) * [1, height]
    return revolve(profile, sides)


def plate(rng: Generator) -> Surface:
    """A thin disc, plank or tile, flat or bent."""
    half = np.array([1, rng.uniform(0.3, 1), rng.uniform(0.015, 0.06)])
    if rng.random() < 0.4:
        profile = np.array([[0, -1], [0.96, -1], [1, -0.5], [1, 0.5], [0.96, 1], [0, 1]]) * [1, half[2]]
        return revolve(profile, 44)
    steps = 18
    along = np.linspace(-1, 1, steps)
    bend = rng.uniform(-0.9, 0.9) * (rng.random() < 0.6)
    wave = rng.uniform(0, 0.12) * (rng.random() < 0.3)
    path = np.stack([along, np.zeros(steps), bend * along**2 / 2 + wave * np.sin(6 * along)], -1)
    section = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return sweep(path, section * [half[1], half[2]] if rng.random() < 0.5 else section * [half[2], half[1]])


def outline(rng: Generator, points: int = 48) -> np.ndarray:
    """A star-shaped outline (points, 2): gears, stars, flowers, leaves, rounded polygons, blobs."""
    angle = np.arange(points) * (2 * math.pi / points)
    kind = rng.integers(0, 5)
    n = int(rng.integers(3, 9))
    if kind == 0:  # gear
        radius = np.where(np.mod(angle * n * 1.5 / (2 * math.pi), 1) < 0.5, 1.0, rng.uniform(0.6, 0.85))
    elif kind == 1:  # star
        radius = 1 - rng.uniform(0.3, 0.65) * np.abs(np.mod(angle * n / (2 * math.pi), 1) - 0.5) * 2
    elif kind == 2:  # flower
        radius = 1 - rng.uniform(0.1, 0.4) * (0.5 - 0.5 * np.cos(n * angle))
    elif kind == 3:  # polygon
        half = math.pi / n
        radius = math.cos(half) / np.cos(np.mod(angle, 2 * half) - half)
    else:  # blob
        radius = np.ones(points)
        for k in range(2, 6):
            radius += rng.normal(0, 0.28 / k) * np.cos(k * angle + rng.uniform(0, 6.3))
    shape = radius.clip(0.15)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return shape / np.abs(shape).max() * [1, rng.uniform(0.6, 1)]


def extrusion(rng: Generator) -> Surface:
    """A cookie-cutter shape, badge, gear or twisted column."""
    half = log_uniform(rng, 0.06, 1.2)
    bevel = min(float(rng.choice([0.01, 0.04, 0.12])), 0.8 * half)
    tall = half > 0.5
    return extrude(
        outline(rng), half, bevel, twist=rng.uniform(-1.5, 1.5) * tall, taper=rng.uniform(-0.2, 0.7) * tall, steps=10 if tall else 2
    )


def curve(rng: Generator) -> np.ndarray:
    """An open path (40, 3): arc, wave, hook, coil, or a free spline."""
    t = np.linspace(0, 1, 40)
    kind = rng.integers(0, 5)
    if kind == 0:  # arch, C, hook
        angle = (t - 0.5) * rng.uniform(1.5, 5.4)
        return np.stack([np.sin(angle), 0 * t, np.cos(angle) * rng.uniform(0.6, 1.4)], -1)
    if kind == 1:  # coil
        turns, slim = rng.integers(2, 6), rng.uniform(0.3, 0.9)
        angle = 2 * math.pi * turns * t
        radius = slim * (1 - rng.uniform(0, 0.7) * t)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), 2 * t - 1], -1)
    if kind == 2:  # S or wave
        return np.stack([0.5 * np.sin(t * rng.uniform(4, 14)), 0 * t, 2 * t - 1], -1)
    if kind == 3:  # straight
        return np.stack([0 * t, 0 * t, 2 * t - 1], -1) + 0.05 * rng.normal(size=3) * t[:, None] ** 2
    knots = rng.uniform(-1, 1, (int(rng.integers(4, 7)), 3))
    return np.asarray(CubicSpline(np.linspace(0, 1, len(knots)), knots)(t))


def tube(rng: Generator) -> Surface:
    """A rod, wire, pipe, horn, strap or handle."""
    path = curve(rng)
    thick = log_uniform(rng, 0.03, 0.3)
    section = circle(10) if rng.random() < 0.65 else np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [1, rng.uniform(0.3, 2)]
    taper = np.linspace(1, rng.uniform(0.1, 1), len(path)) if rng.random() < 0.4 else 1.0
    return sweep(path, thick * section, taper)


def knot(rng: Generator) -> Surface:
    """A torus knot, or a wavy closed band."""
    p, q = [(2, 3), (3, 2), (2, 5), (1, 4), (1, 7)][rng.integers(0, 5)]
    t = np.arange(110) * (2 * math.pi / 110)
    radius = 0.7 + 0.25 * np.cos(q * t)
    path = np.stack([radius * np.cos(p * t), radius * np.sin(p * t), 0.4 * np.sin(q * t)], -1)
    return sweep(path, circle(10, rng.uniform(0.05, 0.16)), closed=True)


def gem(rng: Generator) -> Surface:
    """The convex hull of random points: a cut stone or a low-polygon rock."""
    points = rng.normal(size=(int(rng.integers(7, 40)), 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points * rng.uniform(0.5, 1, 3))
    faces = hull.simplices.copy()
    a, b, c = (hull.points[faces[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return weld(Surface(hull.points, faces))


def lump(rng: Generator) -> Surface:
    """A displaced ball: potato, rock, coral, cloud, fruit."""
    ball = superquadric(1.0, 1.0, 64)
    surface = Surface(ball.vertices * rng.uniform(0.55, 1, 3), ball.faces)
    frequency = log_uniform(rng, 0.8, 4)
    return displace(surface, frequency, rng.uniform(0.05, 0.22) / frequency**0.7, int(rng.integers(1, 4)), rng.uniform(0, 30, 3))


GRID = 34  # samples a side of the distance fields below: 3 to 8 thousand triangles
_GRID_POINTS = np.stack(np.meshgrid(*[np.linspace(-1.25, 1.25, GRID)] * 3, indexing="ij"), -1)


def _distance_ball(rng: Generator, p: np.ndarray) -> np.ndarray:
    scale = rng.uniform(0.6, 1.6, 3)
    return (np.linalg.norm(p * scale, axis=-1) - rng.uniform(0.25, 0.6)) / scale.max()


def _distance_box(rng: Generator, p: np.ndarray) -> np.ndarray:
    q = np.abs(p) - rng.uniform(0.12, 0.6, 3)
    return np.linalg.norm(q.clip(0), axis=-1) + q.max(-1).clip(max=0) - 0.03


def _distance_cylinder(rng: Generator, p: np.ndarray) -> np.ndarray:
    return np.maximum(np.hypot(p[..., 0], p[..., 1]) - rng.uniform(0.12, 0.5), np.abs(p[..., 2]) - rng.uniform(0.2, 0.9))


def _distance_ring(rng: Generator, p: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(p[..., 0], p[..., 1]) - rng.uniform(0.35, 0.7), p[..., 2]) - rng.uniform(0.1, 0.22)


_DISTANCES = (_distance_ball, _distance_ball, _distance_box, _distance_cylinder, _distance_ring)


def carved(rng: Generator) -> Surface:
    """Balls, boxes, cylinders and rings melted together, with others cut out: niches, holes, bites, organic forms."""
    distance = np.full((GRID,) * 3, 9.0)
    melt = float(rng.choice([0.02, 0.1, 0.25]))
    upright = rng.random() < 0.5
    for _ in range(int(rng.integers(2, 6))):
        p = (_GRID_POINTS - rng.uniform(-0.5, 0.5, 3)) @ (np.eye(3) if upright else rotation(rng))
        other = _DISTANCES[rng.integers(0, len(_DISTANCES))](rng, p)
        mix = (0.5 + 0.5 * (other - distance) / melt).clip(0, 1)
        distance = other * (1 - mix) + distance * mix - melt * mix * (1 - mix)
    for _ in range(int(rng.integers(0, 4))):
        p = (_GRID_POINTS - rng.uniform(-0.6, 0.6, 3)) @ (np.eye(3) if upright else rotation(rng))
        distance = np.maximum(distance, -_DISTANCES[rng.integers(0, len(_DISTANCES))](rng, p))
    for axis in range(3):  # nothing reaches the border of the grid
        distance[(slice(None),) * axis + (slice(None, None, GRID - 1),)] = 0.1
    if distance.min() >= 0:  # everything was cut away
        return quadric(rng)
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    return weld(Surface(vertices * (2.5 / (GRID - 1)) - 1.25, faces.astype(np.int64)))


def petal(rng: Generator) -> Surface:
    """A leaf, fin, blade or feather: a lens-shaped outline, thin, curled."""
    steps = 16
    t = np.linspace(0, 1, steps)
    width = rng.uniform(0.2, 0.6) * np.sin(math.pi * t ** rng.uniform(0.6, 1.4)) ** rng.uniform(0.5, 1.2) + 0.01
    path = np.stack([0 * t, rng.uniform(-0.8, 0.8) * t**2, 2 * t - 1], -1)
    section = circle(12) * [1, rng.uniform(0.05, 0.15)] if rng.random() < 0.5 else circle(12) * [rng.uniform(0.05, 0.15), 1]
    return sweep(path, section, width)


def cushion(rng: Generator) -> Surface:
    """A pillow, sack or bag: a soft box with folds."""
    surface = superquadric(rng.uniform(0.5, 0.9), rng.uniform(0.3, 0.7), 56)
    surface = Surface(surface.vertices * np.array([1, rng.uniform(0.5, 1), rng.uniform(0.3, 0.8)]), surface.faces)
    return displace(surface, rng.uniform(1.5, 3), rng.uniform(0.02, 0.06), 2, rng.uniform(0, 30, 3))


SOLIDS = (box, box, quadric, turned, cone, extrusion, gem, lump, carved, cushion, vessel)
THIN = (tube, tube, ring, plate, knot, petal)


def anything(rng: Generator) -> Surface:
    """One building block of any family."""
    family = SOLIDS if rng.random() < 0.72 else THIN
    return family[rng.integers(0, len(family))](rng)
