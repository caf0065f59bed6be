"""Normals that another program has estimated, one picture for each training view: an optional input of ``capture.geometry=sdf``.

They are the camera's: x to the right, y up, z toward the camera, as OpenGL has it, so that wrong poses do not turn them. A PNG
holds (n + 1) / 2 in 8 bits, OpenEXR (R, G, B) and .npy (H, W, 3) hold n itself; vectors shorter than a half say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, user_path
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.photograph import read_array, read_values
from ia_bench.scenes.scene import View

SETTING = "capture.sdf.normals"
SUFFIXES = ".png", ".exr", ".npy"
KNOWN = 0.5  # length from which a stored vector is a normal; that of the code for nothing, grey, is .007
UNIT = 0.1  # by which the median length of normals may differ from 1
SOLID = 0.9  # coverage from which a pixel shows nothing but the object


def given_normals(text: str, views: Sequence[View]) -> list[np.ndarray]:
    """Unit normals (H, W, 3) float32 of every view, each in its camera's axes, from the folder ``text``; 0 where none is known.

    Raises InputError where one is missing, has another size or other lengths, or looks away from the camera that sees it.
    """
    folder = user_path(SETTING, text, folder=True)
    found = [_normals_of(view, folder) for view in views]
    facing = float(np.mean([_facing(*each) for each in zip(views, found, strict=True)]))
    if facing < 0.5:
        raise InputError(
            f"{SETTING}={text}: expected normals of the camera (x to the right, y up, z toward it), found that {1 - facing:.0%} of "
            "them look away from it, as those of the world do, or those in OpenCV's axes"
        )
    return found


def _facing(view: View, normals: np.ndarray) -> float:
    """The share of the known normals that face the camera: what a camera sees faces it."""
    rows, columns = np.nonzero((view.mask > SOLID) & (normals != 0).any(-1))
    toward = -view.camera.rays(columns + 0.5, rows + 0.5) @ view.camera.to_world[:3, :3]
    return float(((normals[rows, columns] * toward).sum(-1) > 0).mean())


def _normals_of(view: View, folder: Path) -> np.ndarray:
    names = [f"{view.name}{suffix}" for suffix in SUFFIXES]
    there = [name for name in names if (folder / name).is_file()]
    if len(there) != 1:
        raise InputError(
            f"{folder}: expected one of {', '.join(names)} for training view {view.name}, found {' and '.join(there) or 'none'}"
        )
    path = file_below(folder, there[0], SETTING)
    stored = _stored(path)
    (height, width), block = view.mask.shape, stored.shape[0] // view.mask.shape[0]
    if block == 0 or stored.shape[:2] != (block * height, block * width):
        size, found = f"{width} x {height}", f"{stored.shape[1]} x {stored.shape[0]}"
        raise InputError(f"{path}: expected {size} pixels like the training view, or a multiple of these, found {found}")
    normals = stored.reshape(height, block, width, block, 3).mean((1, 3))
    length = np.linalg.norm(stored, axis=-1).reshape(height, block, width, block).mean((1, 3))
    solid = (view.mask > SOLID) & (length > KNOWN)
    if not solid.any():
        raise InputError(f"{path}: expected normals where the mask shows the object, found none")
    if abs(np.median(length[solid]) - 1) > UNIT:
        raise InputError(f"{path}: expected unit normals, found a median length of {np.median(length[solid]):.2f}")
    mean = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(mean > KNOWN, normals / np.maximum(mean, KNOWN), 0).astype(np.float32)


def _stored(path: Path) -> np.ndarray:
    """The vectors (H, W, 3) of a file, before anything is asked of them."""
    if path.suffix == ".exr":
        return read_exr(path, 3)
    if path.suffix == ".png":
        values = read_values(path)
        return np.where(values[..., 3:] > KNOWN, 2 * values[..., :3] - 1, 0)
    values = read_array(path)
    if values.ndim != 3 or values.shape[2] != 3:
        raise InputError(f"{path}: expected numbers of shape (H, W, 3), found {values.shape}")
    return values.astype(np.float32)
