"""Values of a scene's JSON files, each checked with a message that names file and key; frames and cameras, as NeRF writes them."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json, shown
from ia_bench.scenes.scene import Camera

Frame = tuple[str, Mapping[str, Any]]
"""How messages name a frame, and what is said of it."""


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


# ---------------------------------------------------------------- frames, as in NeRF's transforms.json
def frames_of(path: Path) -> list[Frame]:
    """Every frame of the file, completed by what the file says of all of them, and how messages name it.

    ``frames`` is a list, or an object whose keys number or name its frames. Raises InputError, also for a photograph that two
    frames name.
    """
    frames = frames_in(path, read_json(path))
    expect_each_once(photographs(frames))
    return frames


def frames_in(path: Path, content: Mapping[str, Any]) -> list[Frame]:
    """The frames of :func:`frames_of`, where the ``content`` of the file is there already; photographs may come twice."""
    shared = {key: value for key, value in content.items() if key != "frames"}
    listed = content.get("frames")
    if isinstance(listed, dict):
        pairs = [(f"{path}: frames[{key!r}]", frame) for key, frame in listed.items()]
    elif isinstance(listed, list):
        pairs = [(f"{path}: frames[{place}]", frame) for place, frame in enumerate(listed)]
    else:
        raise InputError(f"{path}: frames: expected a list, found {type(listed).__name__}")
    if not pairs:
        raise InputError(f"{path}: frames: expected at least one frame, found none")
    for where, frame in pairs:
        if not isinstance(frame, dict):
            raise InputError(f"{where}: expected an object, found {type(frame).__name__}")
    return [(where, {**shared, **frame}) for where, frame in pairs]


def photographs(frames: Sequence[Frame]) -> list[tuple[str, str]]:
    """Where each photograph of ``frames`` is named, and how, with the capture that it is of where a frame says one.

    What is no text is told of where it is opened.
    """
    named = [(where, frame.get("file_path"), frame.get("scene_name")) for where, frame in frames]
    return [(f"{where}: file_path", name if of is None else f"{of}/{name}") for where, name, of in named if isinstance(name, str)]


def expect_each_once(named: Iterable[tuple[str, str]]) -> None:
    """Raise InputError for a photograph that comes twice: it would count twice, or be scored although it was fitted."""
    known: dict[str, str] = {}
    for where, name in named:
        first = known.get(plain(name))
        if first is not None:
            found = f"{name!r} twice" if first == where else f"{name!r} again, as in {first}"
            raise InputError(f"{where}: expected every photograph once, found {found}")
        known[plain(name)] = where


def plain(name: object) -> str:
    """A path without ``./`` and the like, to be compared."""
    return os.path.normpath(str(name))
