"""Rings, circles and rotations from which the figurine is put together."""

from __future__ import annotations

import bpy
import numpy as np

from .forms import grid_surface

TAU = 2.0 * np.pi


def turn_about(axis: int, degrees: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def ring(columns: int) -> np.ndarray:
    """Angles of a ring, counter-clockwise about +z."""
    return np.linspace(0.0, TAU, columns, endpoint=False)


def bump(angle: np.ndarray, centre: float, width: float) -> np.ndarray:
    """Gaussian of the angular distance from `centre`."""
    return np.exp(-((np.angle(np.exp(1j * (angle - centre))) / width) ** 2))


def circle(radius: np.ndarray | float, angle: np.ndarray, z: np.ndarray | float, depth: float = 1.0, y: float = 0.0) -> np.ndarray:
    """Ring of points (columns, 3) at the angles given, its y radius `depth` times its x radius, about (0, y, z)."""
    return np.stack([radius * np.cos(angle), depth * radius * np.sin(angle) + y, z + 0.0 * angle], axis=1)


def sphere(polar: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) from the angle to +z and the angle about it."""
    return np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=-1)


def ellipses(profile: list[tuple[float, ...]], columns: int) -> np.ndarray:
    """Rings from rows (x radius, y radius, z, y offset)."""
    return np.array([circle(a, ring(columns), z, b / a, y) for a, b, z, y in profile])


def blob(name: str, centre: np.ndarray, radii: tuple[float, float, float], paint: bpy.types.Material) -> None:
    """Small ellipsoid."""
    polar = np.linspace(0.92, 0.08, 5) * np.pi
    p, a = np.meshgrid(polar, ring(8), indexing="ij")
    grid_surface(name, sphere(p, a) * radii + centre, paint)
