"""Ways to spoil a dataset's folder as people do: files that are gone, numbers in another unit, pictures of another kind."""

from __future__ import annotations

import json
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from written import save_exr, to_srgb

from ia_bench.scenes.exr import read_exr

Spoil = Callable[[Path], object]
Mistakes = dict[str, tuple[Spoil, str]]
"""By name: what is done to a folder, and what has to be said of it (a regular expression)."""

AXES = r"look away from it; OpenCV's axes .* are exchanged"
TWICE = r"warning: half-covered pixels are 0\.\d+ times as bright.*multiplied by alpha twice"
DEGREES = r"expected radians.*looks like degrees"
MESH = "expected the mesh to cover the masks of the images"


def gone(name: str) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return spoil


def broken_json(name: str) -> Spoil:
    return lambda folder: (folder / name).write_text((folder / name).read_text()[:-40])


def text(name: str, content: str) -> Spoil:
    return lambda folder: (folder / name).write_text(content)


def both(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def beside(spoil: Spoil) -> Spoil:
    """What lies beside the dataset's folder, spoiled."""
    return lambda folder: spoil(folder.parent)


def edit(name: str, change: Callable[[dict[str, Any]], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return spoil


def frame(name: str, change: Callable[[dict[str, Any]], object], *, every: bool = False) -> Spoil:
    """The frame 3 of a list of frames, or every one, changed."""
    return edit(name, lambda content: [change(one) for one in content["frames"][slice(None) if every else slice(3, 4)]])


def matrix(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], object]:
    return lambda one: one.update(transform_matrix=change(np.array(one["transform_matrix"])).tolist())


def metadata(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], object]:
    def changed(one: dict[str, Any]) -> None:
        values = change(np.array([float(part) for part in one["cam_transform_mat"].split(",")]).reshape(4, 4))
        one["cam_transform_mat"] = ",".join(repr(float(value)) for value in values.ravel())

    return changed


def in_all(pattern: str, spoil: Callable[[str], Spoil]) -> Spoil:
    def all_of_them(folder: Path) -> None:
        for path in sorted(folder.glob(pattern)):
            spoil(path.relative_to(folder).as_posix())(folder)

    return all_of_them


def picture(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def spoil(folder: Path) -> None:
        values = np.asarray(Image.open(folder / name))
        Image.fromarray(np.ascontiguousarray(change(values))).save(folder / name)

    return spoil


def bare_png(width: int, height: int) -> bytes:
    """The beginning of a PNG file of RGBA, with next to nothing of its pixels."""
    header = struct.pack(">4sIIBBBBB", b"IHDR", width, height, 8, 6, 0, 0, 0)
    chunks = (header, b"IDAT" + zlib.compress(bytes(99)))
    return b"\x89PNG\r\n\x1a\n" + b"".join(struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)


def opaque(values: np.ndarray) -> np.ndarray:
    return values[..., :3]


def smaller(values: np.ndarray) -> np.ndarray:
    return values[:24, :28]


def multiplied(values: np.ndarray) -> np.ndarray:
    """Colours times alpha in linear values, encoded again."""
    colour, alpha = values[..., :3] / 255, values[..., 3:] / 255
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return np.concatenate([np.round(255 * to_srgb(linear * alpha)).astype(np.uint8), values[..., 3:]], -1)


def black(values: np.ndarray) -> np.ndarray:
    return 0 * values


def shifted(values: np.ndarray) -> np.ndarray:
    return np.roll(values, 9, 1)


def rescaled(to_world: np.ndarray) -> np.ndarray:
    return np.concatenate([2 * to_world[:3], to_world[3:]])


def farther(to_world: np.ndarray) -> np.ndarray:
    """The camera in another unit than the mesh."""
    return to_world * np.array([[1, 1, 1, 3]] * 3 + [[1, 1, 1, 1]])


def other_axes(to_world: np.ndarray) -> np.ndarray:
    """OpenGL's axes for OpenCV's, or the other way round."""
    return to_world @ np.diag([1.0, -1, -1, 1])


def bare_mask(name: str) -> Spoil:
    return picture(name, lambda values: np.full_like(values, 255))


def srgb_as_linear_in(place: str) -> Spoil:
    """Encoded pictures of 8 bits in files that are linear by definition."""

    def spoil(folder: Path) -> None:
        for path in sorted((folder / place).glob("*.exr")):
            save_exr(path, np.round(255 * to_srgb(read_exr(path, 3))) / 255)

    return spoil
