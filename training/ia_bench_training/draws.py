"""Random choices that every part of the generator makes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.random import Generator

T = TypeVar("T")


def pick(rng: Generator, families: Sequence[tuple[T, float]], count: int = 1) -> list[T]:
    """``count`` of the families, each with a chance in proportion to its weight."""
    weights = np.array([weight for _, weight in families])
    return [families[index][0] for index in rng.choice(len(families), count, p=weights / weights.sum())]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def rotation(rng: Generator) -> np.ndarray:
    """A rotation (3, 3), uniform."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def about_z(angle: float) -> np.ndarray:
    """Rotation (3, 3) by ``angle`` around z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def direction_of(elevation: float, azimuth: float) -> np.ndarray:
    """The unit direction (3,) with these angles in radians."""
    c = math.cos(elevation)
    return np.array([c * math.cos(azimuth), c * math.sin(azimuth), math.sin(elevation)])
