"""Photographs of shapes that are known in closed form: balls, and a textured bowl, half of a thick shell, hollow from above."""

import numpy as np
import shapes

from ia_bench.render.gbuffer import primary_rays
from ia_bench.scenes.scene import Camera, View

OUTER, INNER, RIM = 0.7, 0.55, 0.1  # radii of the shell, and the height at which it is cut


def distance(points: np.ndarray) -> np.ndarray:
    """Signed distance (...) of points (..., 3), a lower bound of it outside near the rim."""
    shell = np.abs(np.linalg.norm(points, axis=-1) - 0.5 * (OUTER + INNER)) - 0.5 * (OUTER - INNER)
    return np.maximum(shell, points[..., 2] - RIM)


def normal(points: np.ndarray) -> np.ndarray:
    """Unit gradients of the distance (..., 3)."""
    gradient = np.stack([distance(points + step) - distance(points - step) for step in 1e-3 * np.eye(3)], -1)
    return gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)


def paint(points: np.ndarray, fineness: float) -> np.ndarray:
    """Blotches (..., 3) between .1 and .6."""
    random = np.random.default_rng(0)
    waves = [np.zeros(points.shape[:-1]) for _ in range(3)]
    for channel in range(3):
        for _ in range(24):
            waves[channel] += np.sin(points @ (random.normal(size=3) * fineness) + random.uniform(0, 2 * np.pi))
    return 0.35 + 0.25 * np.tanh(1.5 * np.stack(waves, -1) / np.sqrt(24))


def bowl_view(number: int, camera: Camera, fineness: float, turn: np.ndarray | None = None) -> View:
    """Matt, two lights, and a highlight that moves with the camera; 2 x 2 rays a pixel. It has its normals, as truth.

    ``turn`` (3, 3) takes directions of the bowl into those of the lights.
    """
    turned = np.eye(3) if turn is None else turn
    origin, along = (part.astype(np.float64) for part in primary_rays(camera, 2))
    travelled = np.linalg.norm(origin, axis=-1) - 1
    for _ in range(50):
        travelled = np.minimum(travelled + distance(origin + travelled[..., None] * along), 10)
    points = origin + travelled[..., None] * along
    hit = distance(points) < 2e-3
    normals = normal(points)
    light, other = np.array([0.5, 0.3, 0.81]) @ turned, np.array([-0.9, 0.3, -0.3]) @ turned
    lit = 0.5 + 1.2 * np.maximum(normals @ light, 0) + 0.5 * np.maximum(normals @ other, 0)
    halfway = light - along
    halfway /= np.linalg.norm(halfway, axis=-1, keepdims=True)
    shine = 0.3 * np.maximum((normals * halfway).sum(-1), 0) ** 20
    radiance = np.where(hit[..., None], paint(points, fineness) * lit[..., None] + shine[..., None], 0)
    image, mask = (part.mean(2).astype(np.float32) for part in (radiance, hit))
    return View(f"{number:02d}", camera, image, mask)


def bowl_views(count: int, side: int, fineness: float = 9.0) -> list[View]:
    """``count`` views from all around, ``side`` pixels wide."""
    return [bowl_view(n, camera_at(3 * d, side=side), fineness) for n, d in enumerate(directions(count))]


# ---------------------------------------------------------------- balls, from cameras all around
def camera_at(position: np.ndarray, side: int = 48, width: float = 1.2) -> Camera:
    """A camera that looks at the origin; ``width`` focal lengths fill the image."""
    return shapes.camera_at(position, pixels=side, field_of_view=np.degrees(2 * np.arctan(0.5 / width)))


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
