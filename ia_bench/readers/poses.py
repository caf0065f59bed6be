"""Cameras of other conventions in ours: OpenCV's axes, world-to-camera and projection matrices, and where cameras look.

Ours (:class:`ia_bench.scenes.scene.Camera`) is OpenGL's camera-to-world: -z is seen, +y is up, and the centre of the first pixel
is at (0.5, 0.5). OpenCV's camera sees +z and has +y down; calibrated principal points count from the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import rq

from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import CONVENTIONS, OPENCV_AXES, Camera, View

HALF_PIXEL = 0.5  # from an origin at the centre of the first pixel to one at its corner
SKEW = 1e-3  # of the focal length: what a calibration may leave and no image shows
PARALLEL = 1e-3  # share of the largest eigenvalue below which the axes of cameras do not fix a point
SOME_AWAY = 0.1  # share of cameras that look away, beyond which another convention is tried, even if most look right
CLEARLY, NEAR = 4.0, 0.3  # another convention is right if its angle to what masks show is so many times smaller, and below that


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
    found = _nearest(matrices[:, :3, 3], -matrices[:, :3, 2])
    return None if found is None else float((found < 0).mean())


def _nearest(places: np.ndarray, ahead: np.ndarray) -> np.ndarray | None:
    """The cosines (V,) of the angles between rays and the way to the point that is nearest to all of them; None for parallel rays.

    The rays start at ``places`` (V, 3) and go along ``ahead`` (V, 3).
    """
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    normal = across.sum(0)
    spread = np.linalg.eigvalsh(normal)
    if spread[0] < PARALLEL * spread[-1]:
        return None
    towards = np.linalg.solve(normal, (across @ places[:, :, None]).sum(0)[:, 0]) - places
    cosines: np.ndarray = (towards * ahead).sum(1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
    return cosines


def _aim(views: Sequence[View], matrices: Sequence[np.ndarray]) -> float:
    """The mean angle between where masks say that the object is and the point where it would be for all views, radians.

    ``matrices`` are the cameras' (4, 4), camera-to-world. Near 0 for the right ones; pi where no such point is.
    """
    rays = []
    for view, matrix in zip(views, matrices, strict=True):
        camera, (rows, columns) = view.camera, np.nonzero(view.mask > 0.5 * view.mask.max())
        right, down = columns.mean() + HALF_PIXEL - camera.centre[0], rows.mean() + HALF_PIXEL - camera.centre[1]
        rays.append(matrix[:3, :3] @ [right / camera.focal[0], -down / camera.focal[1], -1.0])
    cosines = _nearest(np.stack([matrix[:3, 3] for matrix in matrices]), np.stack(rays))
    return float(np.pi if cosines is None else np.arccos(cosines.clip(-1, 1)).mean())


def expect_looking_at_object(source: str, views: Sequence[View]) -> None:
    """Raise InputError where most cameras look away from what they surround, or some do that would not in another convention.

    The convention is named under which the masks of the views show one object.
    """
    matrices = [view.camera.to_world for view in views]
    away = share_looking_away(matrices)
    if away is None or away <= SOME_AWAY:
        return
    otherwise = {what: _aim(views, [mended(matrix) for matrix in matrices]) for what, mended in CONVENTIONS.items()}
    best = min(otherwise, key=lambda what: otherwise[what])
    clearly = otherwise[best] < min(NEAR, _aim(views, matrices) / CLEARLY)
    if away <= 0.5 and not clearly:
        return
    cause = "OpenCV's axes (+z forward, +y down) and OpenGL's (-z forward, +y up) are exchanged"
    if clearly and "world-to-camera" in best:
        cause = f"the matrices seem to be {best}: their inverses, which are camera-to-world, look at it"
    elif not clearly:
        cause = "they do in no other known convention either, so the poses or the masks are wrong"
    raise InputError(
        f"{source}: expected cameras that look at the object which they surround, found that {away:.0%} look away from it; {cause}"
    )
