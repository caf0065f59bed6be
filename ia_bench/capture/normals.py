"""Normals that another program has estimated, one picture for each training view: an optional input of ``capture.geometry=sdf``.

They are the camera's: x to the right, y up, z toward the camera, as OpenGL has it, so that wrong poses do not turn them. A PNG
holds (n + 1) / 2 in 8 bits, OpenEXR (R, G, B) and .npy (H, W, 3) hold n itself; vectors shorter than a half say nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, user_path
from ia_bench.geometry.silhouettes import carving_mask, outline_distance
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.photograph import read_array, read_values
from ia_bench.scenes.scene import View

SETTING = "capture.sdf.normals"
SUFFIXES = ".png", ".exr", ".npy"
KNOWN = 0.5  # length from which a stored vector is a normal; that of the code for nothing, grey, is .007
UNIT = 0.1  # by which the median length of normals may differ from 1
SOLID = 0.9  # coverage from which a pixel shows nothing but the object
EDGE = 2.0  # pixels along the inside of an outline where a surface turns away from the camera
CLEARLY = 0.02  # by which other axes have to fit better, as a mean of cosines
AXES = {
    "y points down and z away from the camera, as OpenCV has it": (1, -1, -1),
    "y points down": (1, -1, 1),
    "x points to the left": (-1, 1, 1),
    "z points away from the camera": (1, 1, -1),
    "x points to the left and y down": (-1, -1, 1),
    "x points to the left and z away from the camera": (-1, 1, -1),
    "all of them point inward": (-1, -1, -1),
}
OF_WORLD = "they are the world's, not the camera's"


def given_normals(text: str, views: Sequence[View]) -> list[np.ndarray]:
    """Unit normals (H, W, 3) float32 of every view, each in its camera's axes, from the folder ``text``; 0 where none is known.

    Raises InputError where one is missing, has another size or other lengths, and for axes that outlines and cameras contradict.
    """
    folder = user_path(SETTING, text, folder=True)
    found = [_normals_of(view, folder) for view in views]
    likely = likely_axes(views, found)
    if likely:
        raise InputError(
            f"{SETTING}={text}: expected normals of the camera (x to the right, y up, z toward it), found some that agree better "
            f"with the masks if {likely}"
        )
    return found


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


def likely_axes(views: Sequence[View], normals: Sequence[np.ndarray]) -> str:
    """What is wrong with the axes of normals, in words; empty where none fit better than those that are expected.

    What a camera sees faces it, and beside an outline it faces away from the object: so two cosines are positive in the mean, that
    with the direction to the camera and that with the outward normal of the outline. No axis can be exchanged without one of them
    falling.
    """
    clues = [clue for view, given in zip(views, normals, strict=True) for clue in _clues(view, given)]
    worth = {name: _agreement(clues, np.diag(signs)) for name, signs in AXES.items()}
    worth[OF_WORLD] = _agreement(clues, None)
    best = max(worth, key=lambda name: worth[name])
    return best if worth[best] > _agreement(clues, np.eye(3)) + CLEARLY else ""


def _clues(view: View, normals: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Normals (N, 3), directions (N, 3) that they agree with in the mean, the camera's rotation: inside, then at the outline."""
    camera, turn = view.camera, np.asarray(view.camera.to_world, np.float64)[:3, :3]
    known = (view.mask > SOLID) & (normals != 0).any(-1)
    rows, columns = np.nonzero(known)
    toward = -camera.rays(columns + 0.5, rows + 0.5) @ turn
    yield normals[rows, columns], toward / np.linalg.norm(toward, axis=-1, keepdims=True), turn
    distance = outline_distance(carving_mask(view))
    down, right = np.gradient(distance)
    inner = np.zeros(known.shape, bool)
    inner[2:-2, 2:-2] = True  # the edges of a picture are no outlines
    rows, columns = np.nonzero(known & inner & (distance > -EDGE))
    outward = np.stack([right, -down, np.zeros_like(down)], -1)[rows, columns]
    yield normals[rows, columns], outward / np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-9), turn


def _agreement(clues: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], axes: np.ndarray | None) -> float:
    """The mean cosine of all clues, if normals are turned by ``axes`` (3, 3); by each camera's own rotation for None."""
    means = []
    for kind in (0, 1):
        cosines = [((n @ (turn if axes is None else axes)) * expected).sum(-1) for n, expected, turn in clues[kind::2]]
        together = np.concatenate(cosines)
        means.append(float(together.mean()) if len(together) else 0.0)
    return sum(means)
