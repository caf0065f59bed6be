"""Where the fruit of `fruit.py` lies: spheres that settle in a bowl under gravity, without Blender (numpy only).

Each piece of fruit is a lump of spheres that moves without turning; grapes are single spheres, pulled toward their stalk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TABLE = -0.52
"""Height of the cloth's upper side; the bowl stands on it."""

# Section of the bowl's wood above the table, (radius, height): from the middle of the foot outside, over the rim, back inside.
OUTSIDE = [
    (0.000, 0.021), (0.180, 0.021), (0.228, 0.001), (0.281, -0.002), (0.299, 0.008), (0.293, 0.034), (0.273, 0.049),
    (0.278, 0.061), (0.318, 0.076), (0.413, 0.119), (0.509, 0.189), (0.588, 0.278), (0.623, 0.329), (0.620, 0.338),
    (0.632, 0.345), (0.653, 0.388), (0.650, 0.398), (0.660, 0.405), (0.676, 0.466), (0.683, 0.505), (0.696, 0.515),
    (0.699, 0.532), (0.690, 0.544),
]  # fmt: skip
RIM = [(0.693, 0.560), (0.689, 0.573), (0.675, 0.580), (0.659, 0.575)]
INSIDE = [
    (0.649, 0.551), (0.638, 0.477), (0.606, 0.371), (0.546, 0.267), (0.456, 0.175), (0.339, 0.111), (0.212, 0.080),
    (0.095, 0.070), (0.000, 0.068),
]  # fmt: skip
PROFILE = np.array(OUTSIDE + RIM + INSIDE)

STALK = np.array([
    (-0.03, -0.12, 0.78), (-0.16, -0.28, 0.77), (-0.31, -0.45, 0.73), (-0.41, -0.58, 0.655), (-0.455, -0.65, 0.55),
    (-0.475, -0.68, 0.40),
])  # fmt: skip
"""The grapes' stalk above the table: over the fruit, across the rim, down outside."""

GRAPES, GRAPE = 44, 0.063
"""How many grapes hang there, and their mean radius."""

FALLEN = np.array([(0.50, -0.42, 0.060), (0.39, -0.52, 0.064), (-0.30, 0.50, 0.061)])
"""Grapes on the cloth: x, y, radius."""


@dataclass(frozen=True)
class Lump:
    """A piece of fruit: where it starts above the table, its axis, its size, and spheres (k, 4) x y z radius in units of it."""

    start: tuple[float, float, float]
    axis: tuple[float, float, float]
    size: float
    spheres: np.ndarray


def turned_to(axis: tuple[float, float, float] | np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose third column is `axis`, the first as level as can be."""
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _apple() -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    return np.stack([0.27 * np.cos(turn), 0.27 * np.sin(turn), 0.04 + 0 * turn, 0.72 + 0 * turn], axis=1)


LEMON = np.array([(0, 0, 0, 1.0), (0, 0, 0.45, 0.80), (0, 0, -0.45, 0.80), (0, 0, 1.0, 0.40), (0, 0, -1.0, 0.34)])
PEAR = np.array([(0, 0, 0, 0.88), (0, 0, -0.2, 0.76), (0, 0, 0.38, 0.66), (0.03, 0, 0.75, 0.47), (0.08, 0, 1.2, 0.34)])
ORANGE = np.array([(0.0, 0.0, 0.0, 0.98)])

FRUIT = {
    "red": Lump((-0.351, -0.187, 0.398), (-0.25, -0.45, 0.85), 0.248, _apple()),
    "orange": Lump((0.152, -0.398, 0.398), (0.35, -0.75, 0.55), 0.234, ORANGE),
    "green": Lump((0.421, 0.117, 0.398), (0.55, 0.10, 0.80), 0.234, _apple()),
    "golden": Lump((-0.234, 0.351, 0.398), (-0.45, 0.55, 0.70), 0.240, _apple()),
    "lemon": Lump((0.187, 0.421, 0.374), (0.80, 0.50, 0.10), 0.161, LEMON),
    "pear": Lump((0.070, 0.140, 0.796), (-0.35, 0.20, 0.90), 0.240, PEAR),
    "blushed": Lump((0.140, -0.187, 0.819), (0.30, -0.25, 0.90), 0.232, _apple()),
    "small_lemon": Lump((0.491, -0.164, 0.725), (-0.35, 0.85, 0.30), 0.138, LEMON),
}


def stalk(count: int) -> np.ndarray:
    """Points (count, 3) along the grapes' stalk above the table, evenly in its broken line's length."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(STALK, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(at, length, column) for column in STALK.T], axis=1)


def _wood() -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) all along the bowl's section and their normals out of the wood."""
    step = np.linspace(0.0, 1.0, 12, endpoint=False)[:, None]
    points = np.concatenate([a + step * (b - a) for a, b in zip(PROFILE[:-1], PROFILE[1:], strict=True)])
    along = np.gradient(points, axis=0)
    return points, np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)


def depth_in_wood(centres: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How deep spheres reach into the bowl or below the table (n,), and the way out (n, 3)."""
    points, normals = _wood()
    across = np.hypot(centres[:, 0], centres[:, 1])
    offset = np.stack([across, centres[:, 2]], axis=1)[:, None] - points
    nearest = np.argmin((offset**2).sum(axis=-1), axis=1)
    rows = np.arange(len(centres))
    away, normal = offset[rows, nearest], normals[nearest]
    depth = radii - np.copysign(np.linalg.norm(away, axis=1), (away * normal).sum(axis=1))
    level = centres[:, :2] / np.maximum(across, 1e-9)[:, None]
    way = np.concatenate([level * normal[:, :1], normal[:, 1:]], axis=1)
    below = radii - centres[:, 2]
    table = (below > depth)[:, None]
    return np.maximum(depth, below), np.where(table, (0.0, 0.0, 1.0), way)


def settle(steps: int = 260) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Places in the world, the table at TABLE: the centre (3,) of each fruit, and the grapes (GRAPES, 4) x y z radius.

    Every step pulls all lumps down a little and the grapes toward their stalk, less and less, and pushes what overlaps
    apart, the smaller farther.
    """
    rng = np.random.default_rng(11)
    lumps = list(FRUIT.values())
    spheres, owner = [], []
    for index, lump in enumerate(lumps):
        spheres.append(lump.size * np.concatenate([lump.spheres[:, :3] @ turned_to(lump.axis).T, lump.spheres[:, 3:]], axis=1))
        owner += [index] * len(lump.spheres)
    home = stalk(GRAPES)
    taper = np.interp(np.linspace(0.0, 1.0, GRAPES), (0.0, 0.25, 0.7, 1.0), (0.05, 0.14, 0.11, 0.01))
    turn = 2.4 * np.arange(GRAPES)
    around = taper[:, None] * np.stack([0.8 * np.cos(turn), 0.8 * np.sin(turn), 0.25 + 0.75 * np.abs(np.sin(turn))], axis=1)
    size = GRAPE * rng.uniform(0.88, 1.12, GRAPES)
    offset = np.concatenate([*spheres, np.column_stack([np.zeros((GRAPES, 3)), size])])
    owner = np.concatenate([owner, len(lumps) + np.arange(GRAPES)]).astype(int)
    places = np.concatenate([np.array([lump.start for lump in lumps]), home + around])
    mass = np.concatenate([[lump.size**3 for lump in lumps], size**3])
    radii, apart = offset[:, 3], owner[:, None] != owner[None]
    for step in range(steps):
        force = 1.0 - step / steps
        places[:, 2] -= 0.004 * force
        places[len(lumps) :] += 0.06 * force * (home + 0.5 * around - places[len(lumps) :])
        for _ in range(3):
            centres = places[owner] + offset[:, :3]
            between = centres[:, None] - centres[None]
            distance = np.linalg.norm(between, axis=-1) + 1e-9
            overlap = np.maximum(radii[:, None] + radii[None] - distance, 0.0) * apart
            share = mass[owner][None] / (mass[owner][:, None] + mass[owner][None])
            push = (0.5 * overlap * share / distance)[..., None] * between
            depth, way = depth_in_wood(centres, radii)
            wood = np.maximum(depth, 0.0)[:, None] * way
            for index in range(len(places)):
                own = owner == index
                places[index] += push[own].sum(axis=(0, 1)) + wood[own][np.argmax(depth[own])]
    places[:, 2] += TABLE
    return dict(zip(FRUIT, places, strict=False)), np.column_stack([places[len(lumps) :], size])
