"""Cameras of other conventions in ours, and the JSON that they are read from, each mistake in one sentence that names file and key.

Ours (:class:`ia_bench.scenes.scene.Camera`) is OpenGL's camera-to-world: -z is seen, +y is up, and the centre of the first pixel
is at (0.5, 0.5). OpenCV's camera sees +z and has +y down; its principal points, as in DTU's matrices, count from
the centre of the first pixel.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json, shown
from ia_bench.readers.contract import check_camera
from ia_bench.scenes.scene import OPENCV_AXES, Camera, View

NamedFrame = tuple[str, Mapping[str, Any]]
"""How messages name a frame of transforms.json, and what is said of it."""
PATHS = "file_path", "mask_path"
FOCAL_KEYS = frozenset({"fl_x", "fl_y", "camera_angle_x"})
"""The keys that say a focal length. A frame that has that of its columns has all of its own, for they may contradict the file's."""
SKEW = 1e-3  # of the focal length: what a calibration may leave and no image shows
PARALLEL = 1e-3  # share of the largest eigenvalue below which the axes of cameras do not fix a point


# ---------------------------------------------------------------- values of JSON
def number(where: str, fields: Mapping[str, Any], key: str) -> float:
    """``fields[key]`` as a finite number. Raises InputError, naming ``where`` and the key, for anything else."""
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key}: expected a finite number, found {shown(repr(value))}")
    return float(value)


def positive(where: str, fields: Mapping[str, Any], key: str) -> float:
    """``fields[key]`` as a number above 0. Raises InputError, naming ``where`` and the key."""
    value = number(where, fields, key)
    if value <= 0:
        raise InputError(f"{where}: {key}: expected a number above 0, found {value:g}")
    return value


def text(where: str, fields: Mapping[str, Any], key: str, default: str) -> str:
    """``fields[key]`` as text, ``default`` where it is absent. Raises InputError, naming ``where`` and the key."""
    value = fields.get(key, default)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key}: expected text, found {shown(repr(value))}")
    return value


def numbers(value: object) -> np.ndarray:
    """Numbers of JSON, of any shape, as float64; an empty array for anything else, texts of digits among it."""
    try:
        found = np.asarray(value)
    except ValueError:  # lists of several lengths
        return np.zeros(0)
    return found.astype(np.float64) if found.dtype.kind in "iuf" else np.zeros(0)


def rigid(where: str, key: str, value: object) -> np.ndarray:
    """``value``, read from ``key``, as a rotation and a translation (4, 4) float64. Raises InputError for anything else."""
    to_world = numbers(value)
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all():
        found = "NaN or infinity" if to_world.shape == (4, 4) else f"shape {to_world.shape}"
        raise InputError(f"{where}: {key}: expected 4 x 4 finite numbers, found {found}")
    rotation = to_world[:3, :3]
    if np.abs(to_world[3] - (0, 0, 0, 1)).max() > 1e-6:  # a transposed matrix holds a rotation too
        raise InputError(f"{where}: {key}: expected the last row 0 0 0 1, found {to_world[3].tolist()}")
    with np.errstate(over="ignore", invalid="ignore"):
        error, determinant = np.abs(rotation @ rotation.T - np.eye(3)).max(), np.linalg.det(rotation)
    if not (error <= 1e-3 and determinant > 0):
        found = f"|R R^T - 1| = {error:.3g}, det = {determinant:.3g}"
        raise InputError(f"{where}: {key}: expected a rotation (R R^T = 1, det = +1), found {found}")
    to_world[3] = 0, 0, 0, 1  # as a product of matrices leaves it but for rounding
    return to_world


def focal_of(where: str, key: str, angle: float, width: int) -> float:
    """The focal length in pixels of a camera that sees ``angle`` radians across ``width`` pixels. Raises InputError."""
    if not 0 < angle < math.pi:
        raise InputError(f"{where}: {key}: expected radians between 0 and pi, found {angle:g}")
    return 0.5 * width / math.tan(0.5 * angle)


# ---------------------------------------------------------------- frames, as in NeRF's transforms.json
def frames_of(path: Path) -> list[NamedFrame]:
    """Every frame of the file, completed by what the file says of all of them, and how messages name it.

    ``frames`` is a list, or an object whose keys number or name its frames; Windows' paths become ours, as Instant-NGP does it.
    Raises InputError, also for a photograph that two frames name.
    """
    content = read_json(path)
    listed = content.pop("frames", None)
    if not isinstance(listed, list | dict):
        raise InputError(f"{path}: frames: expected a list, found {type(listed).__name__}")
    frames: list[NamedFrame] = []
    for key, frame in listed.items() if isinstance(listed, dict) else enumerate(listed):
        where = f"{path}: frames[{key!r}]"
        if not isinstance(frame, dict):
            raise InputError(f"{where}: expected an object, found {type(frame).__name__}")
        paths = {key: value.replace("\\", "/") for key, value in frame.items() if key in PATHS and isinstance(value, str)}
        left_out = FOCAL_KEYS if (FOCAL_KEYS - {"fl_y"}) & frame.keys() else frozenset()
        if "fl_x" in frame and "fl_x" not in content:  # then the file's fl_y is that of all frames, and their fl_x are several
            left_out -= {"fl_y"}
        shared = {key: value for key, value in content.items() if key not in left_out}
        frames.append((where, {**shared, **frame, **paths}))
    expect_each_once(photographs(frames))
    return frames


def frames_if_there(path: Path) -> list[NamedFrame]:
    """:func:`frames_of` a file that need not be there: a folder, a device or a link to nowhere in its place is a mistake."""
    return frames_of(path) if os.path.lexists(path) else []


def photographs(frames: Sequence[NamedFrame]) -> list[tuple[str, str]]:
    """Where each photograph of ``frames`` is named, and how, with the capture that it is of (Stanford-ORB's ``scene_name``)."""
    named = [(where, frame) for where, frame in frames if "file_path" in frame]  # of others it is said once they are read
    return [(f"{where}: file_path", f"{frame.get('scene_name', '.')}/{frame['file_path']}") for where, frame in named]


def expect_each_once(named: Iterable[tuple[str, str]]) -> None:
    """Raise InputError for a photograph that comes twice: it would count twice, or be scored although it was fitted."""
    known: dict[str, str] = {}
    for where, name in named:
        if plain(name) in known:
            raise InputError(f"{where}: expected every photograph once, found {name!r} again, as in {known[plain(name)]}")
        known[plain(name)] = where


def plain(name: object) -> str:
    """A path without ``./`` and the like, to be compared."""
    return os.path.normpath(str(name).replace("\\", "/"))


def camera(where: str, frame: Mapping[str, Any], shape: tuple[int, ...]) -> Camera:
    """The camera of a frame of transforms.json: transform_matrix and camera_angle_x, or fl_x, fl_y, and cx, cy, in pixels.

    Its photograph is of ``shape`` (H, W, ...).
    """
    height, width = shape[:2]
    to_world = rigid(where, "transform_matrix", frame.get("transform_matrix"))
    if "fl_x" in frame:
        focal = positive(where, frame, "fl_x"), positive(where, frame, "fl_y" if "fl_y" in frame else "fl_x")
    elif "camera_angle_x" in frame:
        focal = (focal_of(where, "camera_angle_x", number(where, frame, "camera_angle_x"), width),) * 2
    else:
        raise InputError(f"{where}: expected camera_angle_x or fl_x, found neither")
    middle = {"cx": 0.5 * width, "cy": 0.5 * height, **frame}
    centre = number(where, middle, "cx"), number(where, middle, "cy")
    return check_camera(where, Camera(to_world, focal, centre, width, height))


def expect_size_of(where: str, frame: Mapping[str, Any], path: Path, shape: tuple[int, ...]) -> None:
    """Raise InputError where a frame of transforms.json says another ``w`` or ``h`` than its photograph ``path`` has."""
    for key, size in (("w", shape[1]), ("h", shape[0])):
        if key in frame and number(where, frame, key) != size:
            raise InputError(f"{path}: expected {key} = {frame[key]:g}, as {where} says, found {size}")


# ---------------------------------------------------------------- matrices
def from_world_to_camera(to_camera: np.ndarray) -> np.ndarray:
    """The OpenGL camera-to-world matrix (4, 4) of an OpenCV world-to-camera one, both without a scale."""
    to_world = np.eye(4)
    to_world[:3, :3] = to_camera[:3, :3].T
    to_world[:3, 3] = -to_camera[:3, :3].T @ to_camera[:3, 3]
    return to_world @ OPENCV_AXES


def from_projection(where: str, projection: np.ndarray, width: int, height: int) -> Camera:
    """The camera of an OpenCV projection P = K [R | t] (3, 4), of any scale and sign, that counts from the first pixel's centre.

    K and R are the RQ factors of P's left 3 x 3 with K's diagonal positive and R a rotation (Hartley and Zisserman 2004, 6.2.4).
    Raises InputError for a matrix that is none, and for pixels that are no rectangles.
    """
    left = projection[:, :3]
    determinant = np.linalg.det(left)
    if abs(determinant) <= 1e-12 * np.linalg.norm(left) ** 3:
        raise InputError(f"{where}: expected a projection of full rank, found one with determinant {determinant:.3g}")
    from scipy.linalg import rq  # here, for most scenes need none of scipy

    intrinsic, rotation = rq(np.sign(determinant) * left)
    signs = np.sign(np.diag(intrinsic))
    intrinsic, rotation = intrinsic * signs, signs[:, None] * rotation
    intrinsic = intrinsic / intrinsic[2, 2]
    if abs(intrinsic[0, 1]) > SKEW * intrinsic[0, 0]:
        raise InputError(f"{where}: expected rectangular pixels, found a skew of {intrinsic[0, 1]:.3g} pixels")
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation.T, -np.linalg.solve(left, projection[:, 3])
    centre = (float(intrinsic[0, 2]) + 0.5, float(intrinsic[1, 2]) + 0.5)
    focal = float(intrinsic[0, 0]), float(intrinsic[1, 1])
    return check_camera(where, Camera(to_world @ OPENCV_AXES, focal, centre, width, height))


# ---------------------------------------------------------------- do cameras look at the object?
def share_away(views: Sequence[View]) -> float:
    """The share of cameras that look away from what all of them surround, 0 for right matrices and 1 for exchanged axes.

    Compared are the ray through the middle of a mask and the way to the point that is nearest to all such rays, by least squares.
    Where rays are parallel there is no such point, and 0 is returned. A view whose mask is empty is no camera of the object.
    """
    views = [view for view in views if view.mask.any()]
    if not views:
        return 0.0
    middles = [np.nonzero(view.mask > 0.5 * view.mask.max()) for view in views]
    rays = np.stack([v.camera.rays(x.mean() + 0.5, y.mean() + 0.5) for v, (y, x) in zip(views, middles, strict=True)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places = np.stack([view.camera.position for view in views])
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = across.sum(0)
    spread = np.linalg.eigvalsh(normal)
    if spread[0] < PARALLEL * spread[-1]:
        return 0.0
    towards = np.linalg.solve(normal, (across @ places[:, :, None]).sum(0)[:, 0]) - places
    return float(((towards * rays).sum(1) < 0).mean())


def expect_looking_at_object(source: str, views: Sequence[View]) -> None:
    """Raise InputError where most cameras look away from what they surround."""
    away = share_away(views)
    if away > 0.5:
        raise InputError(
            f"{source}: expected cameras that look at the object which they surround, found that {away:.0%} look away from it; "
            "usually OpenCV's axes (+z forward, +y down) and OpenGL's (-z forward, +y up) are exchanged, or matrices are inverted"
        )
