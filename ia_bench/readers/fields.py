"""Values of a scene's JSON files, each checked with a message that names file and key; and cameras, as nerfstudio writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.scenes.scene import Camera


def number(where: str, fields: Mapping[str, Any], key: str) -> float:
    """``fields[key]`` as a finite number. Raises InputError, naming ``where`` and the key, for anything else."""
    value = fields[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key}: expected a finite number, found {shown(repr(value))}")
    return float(value)


def text(where: str, fields: Mapping[str, Any], key: str, default: str) -> str:
    """``fields[key]`` as text, ``default`` where it is absent. Raises InputError, naming ``where`` and the key."""
    value = fields.get(key, default)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key}: expected text, found {shown(repr(value))}")
    return value


def camera(where: str, frame: Mapping[str, Any], width: int, height: int) -> Camera:
    """The camera of a frame of transforms.json: transform_matrix and camera_angle_x, or fl_x, fl_y, and cx, cy, in pixels."""
    to_world = rigid(where, "transform_matrix", frame.get("transform_matrix"))
    if "fl_x" in frame:
        focal = number(where, frame, "fl_x"), number(where, frame, "fl_y" if "fl_y" in frame else "fl_x")
        if min(focal) <= 0:
            raise InputError(f"{where}: fl_x, fl_y: expected a positive focal length, found {focal}")
    elif "camera_angle_x" in frame:
        angle = number(where, frame, "camera_angle_x")
        focal = (focal_of(where, "camera_angle_x", angle, width),) * 2
    else:
        raise InputError(f"{where}: expected camera_angle_x or fl_x, found neither")
    centre = (
        number(where, frame, "cx") if "cx" in frame else 0.5 * width,
        number(where, frame, "cy") if "cy" in frame else 0.5 * height,
    )
    return Camera(to_world=to_world, focal=focal, centre=centre, width=width, height=height)


def focal_of(where: str, key: str, angle: float, width: int) -> float:
    """The focal length in pixels of a camera that sees ``angle`` radians across ``width`` pixels. Raises InputError."""
    if not 0 < angle < math.pi:
        cause = "; it looks like degrees" if math.pi < angle < 180 else ""
        raise InputError(f"{where}: {key}: expected radians between 0 and pi, found {angle:g}{cause}")
    return 0.5 * width / math.tan(0.5 * angle)


def numbers(value: object) -> np.ndarray:
    """Numbers of JSON, of any shape, as float64; an empty array for anything else."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(0)


def rigid(where: str, key: str, value: object) -> np.ndarray:
    """``value``, read from ``key``, as a rotation and a translation (4, 4) float64. Raises InputError for anything else."""
    to_world = numbers(value)
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all():
        raise InputError(f"{where}: {key}: expected 4 x 4 finite numbers, found shape {to_world.shape}")
    rotation = to_world[:3, :3]
    if np.abs(to_world[3] - (0, 0, 0, 1)).max() > 1e-6:  # a transposed matrix holds a rotation too
        raise InputError(f"{where}: {key}: expected the last row 0 0 0 1, found {to_world[3].tolist()}")
    with np.errstate(over="ignore", invalid="ignore"):
        error, determinant = np.abs(rotation @ rotation.T - np.eye(3)).max(), np.linalg.det(rotation)
    if not (error <= 1e-3 and determinant > 0):
        raise InputError(
            f"{where}: {key}: expected a rotation (R R^T = 1, det = +1), found |R R^T - 1| = {error:.3g}, det = {determinant:.3g}"
        )
    return to_world
