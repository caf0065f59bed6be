"""Cameras of other conventions in ours: OpenCV's axes, world-to-camera and projection matrices, lenses, and where cameras look.

Ours (:class:`ia_bench.scenes.scene.Camera`) is OpenGL's camera-to-world: -z is seen, +y is up, and the centre of the first pixel
is at (0.5, 0.5). OpenCV's camera sees +z and has +y down; calibrated principal points count from the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import rq
from scipy.ndimage import map_coordinates

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.readers.fields import number
from ia_bench.scenes.scene import CONVENTIONS, OPENCV_AXES, Camera, View

HALF_PIXEL = 0.5  # from an origin at the centre of the first pixel to one at its corner
SKEW = 1e-3  # of the focal length: what a calibration may leave and no image shows
PARALLEL = 1e-3  # share of the largest eigenvalue below which the axes of cameras do not fix a point
SOME_AWAY = 0.1  # share of cameras that look away, beyond which another convention is tried, even if most look right
CLEARLY, NEAR = 4.0, 0.3  # another convention is right if its angle to what masks show is so many times smaller, and below that


# ---------------------------------------------------------------- matrices
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


# ---------------------------------------------------------------- do cameras look at the object?
def looking(views: Sequence[View], mended: Callable[[np.ndarray], np.ndarray] = np.asarray) -> np.ndarray | None:
    """The cosines (V,) of the angles between where masks say that the object is and where it would be for all views.

    The one is the ray through the middle of a mask, the other the way to the point that is nearest to all such rays, by least
    squares. Cosines are near 1 for right matrices, and for those with exchanged axes near -1. ``mended`` is what is done to every
    matrix first. None where rays are parallel, so that there is no such point.
    """
    cameras = [replace(view.camera, to_world=mended(view.camera.to_world)) for view in views]
    middles = [np.nonzero(view.mask > 0.5 * view.mask.max()) for view in views]
    rays = np.stack([c.rays(x.mean() + HALF_PIXEL, y.mean() + HALF_PIXEL) for c, (y, x) in zip(cameras, middles, strict=True)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places = np.stack([camera.position for camera in cameras])
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = across.sum(0)
    spread = np.linalg.eigvalsh(normal)
    if spread[0] < PARALLEL * spread[-1]:
        return None
    towards = np.linalg.solve(normal, (across @ places[:, :, None]).sum(0)[:, 0]) - places
    cosines: np.ndarray = (towards * rays).sum(1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
    return cosines


def _angle(cosines: np.ndarray | None) -> float:
    return float(np.pi if cosines is None else np.arccos(cosines.clip(-1, 1)).mean())


def expect_looking_at_object(source: str, views: Sequence[View]) -> None:
    """Raise InputError where most cameras look away from what they surround, or some do that would not in another convention.

    The convention is named under which the masks of the views show one object.
    """
    found = looking(views)
    away = 0.0 if found is None else float((found < 0).mean())
    if away <= SOME_AWAY:
        return
    otherwise = {what: _angle(looking(views, mended)) for what, mended in CONVENTIONS.items()}
    best = min(otherwise, key=lambda what: otherwise[what])
    clearly = otherwise[best] < min(NEAR, _angle(found) / CLEARLY)
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


# ---------------------------------------------------------------- lenses
PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
BROWNS = ("OPENCV", "RADIAL", "SIMPLE_RADIAL", "perspective")
FOLDED = 1e-9  # a slope or an area below it: two points in one place


@dataclass(frozen=True)
class Lens:
    """The coefficients of Brown's model, as OpenCV, COLMAP and nerfstudio write it (y down); without unit, for the plane z = 1.

    A point at (x, y) of that plane is photographed at (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8), r^2 = x^2 + y^2, plus
    (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y).
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def straight(self) -> bool:
        """Whether it is a pinhole."""
        return not any(asdict(self).values())

    def distorted(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the points (x, y) of the plane z = 1 are photographed, on the same plane."""
        square = x * x + y * y
        radial = 1 + square * (self.k1 + square * (self.k2 + square * (self.k3 + square * self.k4)))
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x),
            y * radial + self.p1 * (square + 2 * y * y) + 2 * self.p2 * x * y,
        )


def lens(where: str, frame: Mapping[str, Any]) -> Lens:
    """The lens of a frame of transforms.json: ``camera_model`` and k1, k2, k3, k4, p1, p2, each 0 where it is absent.

    Raises InputError, with its name, for a model that is none of these, and for a model that has no such coefficients.
    """
    model = frame.get("camera_model", "OPENCV")
    if model not in (*PINHOLES, *BROWNS):
        raise InputError(
            f"{where}: camera_model: expected one of {', '.join((*PINHOLES, *BROWNS))}, found {shown(repr(model))}; "
            "undistort the photographs first (colmap image_undistorter)"
        )
    found = Lens(**{key: number(where, frame, key) for key in asdict(Lens()) if key in frame})
    if model in PINHOLES and not found.straight:
        raise InputError(f"{where}: camera_model: expected no distortion of a {model} camera, found {found}")
    return found


def undistorted(where: str, view: View, glass: Lens) -> View:
    """A view through ``glass`` as its pinhole camera would have seen it, bilinear.

    Pixels beyond the photograph are unknown: black, mask 0, not ``valid``.

    Raises InputError for coefficients under which the photograph folds over, which no lens has, and for an object that is lost.
    """
    if glass.straight:
        return view
    (height, width), focal, centre = view.mask.shape, view.camera.focal, view.camera.centre
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = (column - centre[0]) / focal[0], (row - centre[1]) / focal[1]
    u, v = glass.distorted(x, y)
    # The Jacobian of Brown's model is symmetric. Where it is positive definite all over a rectangle, no two points of it meet.
    slope, slant = np.gradient(u, axis=1) * focal[0], np.gradient(u, axis=0) * focal[1]
    area = slope * np.gradient(v, axis=0) * focal[1] - slant * np.gradient(v, axis=1) * focal[0]
    if min(slope.min(), area.min()) < FOLDED or not np.isfinite(area).all():
        raise InputError(f"{where}: expected the distortion of a lens, found one under which the picture folds over: {glass}")
    place = [v * focal[1] + centre[1] - 0.5, u * focal[0] + centre[0] - 0.5]
    seen = (place[0] >= -0.5) & (place[0] <= height - 0.5) & (place[1] >= -0.5) & (place[1] <= width - 0.5)

    def moved(values: np.ndarray) -> np.ndarray:
        layers = values.reshape(height, width, -1).astype(np.float32)
        found = [map_coordinates(layers[..., c], place, order=1, mode="nearest") for c in range(layers.shape[-1])]
        return (np.stack(found, -1) * seen[..., None]).reshape(values.shape)

    image, mask = moved(view.image), moved(view.mask)
    if not (mask > 0.5).any():
        raise InputError(f"{where}: expected an object within the photograph, found none once the lens is undone")
    image[mask <= 0] = 0
    valid = seen & (moved(~view.known) == 0)
    return replace(view, image=image, mask=mask, valid=None if view.valid is None and seen.all() else valid)
