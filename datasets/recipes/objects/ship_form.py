"""Form of the ship's hull: one analytic surface, and the deck and rail lines on it. The bow points along +x, z up."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

KEEL = -0.72  # height of the keel's upper edge
SHEER, SHEER_X, SHEER_Z = 0.32, 0.08, -0.36  # main deck line: z = SHEER (x - SHEER_X)**2 + SHEER_Z
POOP, QUARTER, FORECASTLE = -0.50, -0.24, 0.27  # x of the breaks between the decks
SIDES = (-1.0, 1.0)


def sheer(x: np.ndarray | float) -> np.ndarray | float:
    """Height of the main deck line."""
    return SHEER * (x - SHEER_X) ** 2 + SHEER_Z


def deck_height(x: float) -> float:
    """Height of the deck above the keel line at x, with steps up to the forecastle, quarterdeck and poop."""
    step = 0.165 if x < POOP else 0.09 if x < QUARTER else 0.08 if x > FORECASTLE else 0.0
    return float(sheer(x)) + step


def rail_height(x: float) -> float:
    """Height of the planked hull side at x: a bulwark in the waist, a low sill under the balustrades elsewhere."""
    return deck_height(x) + (0.07 if QUARTER <= x <= FORECASTLE else 0.024)


def stern_x(z: np.ndarray | float) -> np.ndarray | float:
    """Position of the raked sternpost and transom at height z."""
    return -0.565 - 0.245 * (z - KEEL)


def bow_x(z: np.ndarray | float) -> np.ndarray | float:
    """Position of the curved stem at height z."""
    return 0.34 + 0.24 * (1.0 - (1.0 - np.clip((z - KEEL) / 0.5, 0.0, 1.0)) ** 2)


def half_breadth(x: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Half width of the hull: round bilge with tumblehome above, full bow, transom stern."""
    x, z = np.asarray(x, float), np.asarray(z, float)
    height = np.maximum((z - KEEL) / 0.40, 0.0)
    low = np.minimum(height, 1.0)
    middle = 0.225 * (1.0 - (1.0 - low) ** 2.4) ** 0.62 * (1.0 - 0.22 * np.maximum(height - 1.0, 0.0))
    u = np.clip((x - stern_x(z)) / (bow_x(z) - stern_x(z)), 0.0, 1.0)
    fore_start = 0.35 + 0.30 * low
    fore = np.clip((u - fore_start) / (1.0 - fore_start), 0.0, 1.0)
    aft = np.clip((0.45 - u) / 0.45, 0.0, 1.0)
    t = np.clip((height - 0.5) / 0.55, 0.0, 1.0)
    transom = 0.72 * t * t * (3.0 - 2.0 * t)
    return middle * (1.0 - fore**2.2) ** (1.15 - 0.5 * low) * (transom + (1.0 - transom) * (1.0 - aft**2))


def stations(start: float, end: float, count: int) -> np.ndarray:
    """Positions along the ship, denser toward the bow where the plan curves most."""
    t = np.linspace(0.0, 1.0, count)
    return start + (end - start) * (t if end < 0.4 else 1.0 - (1.0 - t) ** 1.5)


def side_path(xs: Iterable[float], height: Callable[[float], float], side: float, inset: float = 0.0) -> np.ndarray:
    """Points (n, 3) on the hull side at the given heights, moved inboard by `inset`."""
    return np.array([(x, side * (float(half_breadth(x, height(x))) - inset), height(x)) for x in xs])


def rectangle(width: float, height: float) -> np.ndarray:
    """Profile of a moulding."""
    return 0.5 * np.array([(-width, -height), (width, -height), (width, height), (-width, height)])
