"""Photographs of balls whose masks are known in closed form: cameras all around, coverage by many rays a pixel."""

from __future__ import annotations

import numpy as np

from ia_bench.render.gbuffer import primary_rays
from ia_bench.scenes.scene import Camera, View


def camera_at(position: np.ndarray, side: int = 48, width: float = 1.2) -> Camera:
    """A camera that looks at the origin; ``width`` focal lengths fill the image."""
    back = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0] if abs(back[2]) < 0.9 else [0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3] = np.column_stack([right, np.cross(back, right), back, position])
    return Camera(to_world, (side * width, side * width), (side / 2, side / 2), side, side)


def directions(count: int) -> np.ndarray:
    """A Fibonacci lattice on the unit sphere, (count, 3)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])


def ball_view(number: int, camera: Camera, radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> View:
    """A white ball; its coverage is counted over 5 x 5 rays a pixel."""
    origin, along = primary_rays(camera, 5)
    origin = origin - np.array(centre, np.float32)
    closest = (origin**2).sum(-1) - (origin * along).sum(-1) ** 2
    mask = (closest < radius**2).mean(-1).astype(np.float32)
    return View(f"{number:02d}", camera, np.repeat(mask[..., None], 3, -1), mask)


def ball_views(count: int, radius: float = 0.7, distance: float = 3.0, **of_camera: float) -> list[View]:
    """``count`` views of a ball at the origin."""
    return [ball_view(n, camera_at(distance * d, **of_camera), radius) for n, d in enumerate(directions(count))]
