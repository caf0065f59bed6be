"""Cameras of other conventions in ours: OpenCV's axes, world-to-camera and projection matrices, and where cameras look.

Ours (:class:`ia_bench.scenes.scene.Camera`) is OpenGL's camera-to-world: -z is seen, +y is up, and the centre of the first pixel
is at (0.5, 0.5). OpenCV's camera sees +z and has +y down; calibrated principal points count from the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import rq

from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import Camera, View

OPENCV_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
HALF_PIXEL = 0.5  # from an origin at the centre of the first pixel to one at its corner
SKEW = 1e-3  # of the focal length: what a calibration may leave and no image shows
PARALLEL = 1e-3  # share of the largest eigenvalue below which the axes of cameras do not fix a point


def from_opencv(to_world: np.ndarray) -> np.ndarray:
    """An OpenCV camera-to-world matrix (4, 4) with the axes of OpenGL."""
    return to_world @ OPENCV_AXES


def from_world_to_camera(to_camera: np.ndarray) -> np.ndarray:
    """The OpenGL camera-to-world matrix (4, 4) of an OpenCV world-to-camera one, both without a scale."""
    to_world = np.eye(4)
    to_world[:3, :3] = to_camera[:3, :3].T
    to_world[:3, 3] = -to_camera[:3, :3].T @ to_camera[:3, 3]
    return from_opencv(to_world)


def from_projection(where: str, projection: np.ndarray, width: int, height: int) -> Camera:
    """The camera of an OpenCV projection P = K [R | t] (3, 4), of any scale and sign, that counts from the first pixel's centre.

    K and R are the RQ factors of P's left 3 x 3 with K's diagonal positive and R a rotation (Hartley and Zisserman 2004, 6.2.4).
    Raises InputError for a matrix that is none, and for pixels that are no rectangles.
    """
    if projection.shape != (3, 4) or not np.isfinite(projection).all():
        raise InputError(f"{where}: expected a projection of 3 x 4 finite numbers, found shape {projection.shape}")
    left = projection[:, :3]
    determinant = np.linalg.det(left)
    if abs(determinant) <= 1e-12 * np.linalg.norm(left) ** 3:
        raise InputError(f"{where}: expected a projection of full rank, found one with determinant {determinant:.3g}")
    intrinsic, rotation = rq(np.sign(determinant) * left)
    signs = np.sign(np.diag(intrinsic))
    intrinsic, rotation = intrinsic * signs, signs[:, None] * rotation
    intrinsic = intrinsic / intrinsic[2, 2]
    if abs(intrinsic[0, 1]) > SKEW * intrinsic[0, 0]:
        raise InputError(f"{where}: expected rectangular pixels, found a skew of {intrinsic[0, 1]:.3g} pixels")
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation.T, -np.linalg.solve(left, projection[:, 3])
    centre = (float(intrinsic[0, 2]) + HALF_PIXEL, float(intrinsic[1, 2]) + HALF_PIXEL)
    return Camera(from_opencv(to_world), (float(intrinsic[0, 0]), float(intrinsic[1, 1])), centre, width, height)


def share_looking_away(to_world: Sequence[np.ndarray]) -> float | None:
    """The share of OpenGL cameras behind which the point lies that all look along; None where there is no such point.

    The point is the nearest one to all optical axes, by least squares. Cameras around an object have it in front of them,
    and behind them where OpenCV's axes are taken for OpenGL's.
    """
    matrices = np.stack(to_world)
    ahead, places = -matrices[:, :3, 2], matrices[:, :3, 3]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    normal = across.sum(0)
    spread = np.linalg.eigvalsh(normal)
    if spread[0] < PARALLEL * spread[-1]:
        return None
    point = np.linalg.solve(normal, (across @ places[:, :, None]).sum(0)[:, 0])
    return float((((point - places) * ahead).sum(1) < 0).mean())


def expect_looking_at_object(source: str, views: Sequence[View]) -> None:
    """Raise InputError where most cameras look away from what they surround: their axes are not those that the format has."""
    away = share_looking_away([view.camera.to_world for view in views])
    if away is not None and away > 0.5:
        raise InputError(
            f"{source}: expected cameras that look at the object which they surround, found that {away:.0%} look away from it; "
            "OpenCV's axes (+z forward, +y down) and OpenGL's (-z forward, +y up) are exchanged"
        )
