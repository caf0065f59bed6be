"""How files of a folder are spoiled: each of these gives what does it to a folder."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.scenes.exr import read_exr, write_exr

Spoil = Callable[[Path], Any]


def gone(name: str) -> Spoil:
    """A file, or a folder with all that is in it."""

    def spoil(folder: Path) -> None:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return spoil


def wrote(name: str, content: object) -> Spoil:
    """Bytes and text as they are, anything else as JSON."""
    text = content if isinstance(content, bytes | str) else json.dumps(content)
    return lambda folder: (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)


def edited(name: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], dict[str, Any]]:
    """The table of a JSON file, changed; it is returned too."""

    def spoil(folder: Path) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))
        return content

    return spoil


def exr(name: str, channels: int, to: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda folder: write_exr(folder / name, to(read_exr(folder / name, channels)), half=False)


def picture(*names: str, to: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def spoil(folder: Path) -> None:
        for name in names:
            Image.fromarray(np.ascontiguousarray(to(np.asarray(Image.open(folder / name))))).save(folder / name)

    return spoil
