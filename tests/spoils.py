"""How files of a folder are spoiled: each of these gives what does it to a folder."""

import json
import random
import shutil
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.scenes.exr import read_exr, write_exr

Spoil = Callable[[Path], Any]
ODD_TEXTS = ("", "text", "a\0b", "\ud800", "../x", "/dev/zero", "$$", "x" * 3000)
JSON = (None, [], {}, [[]], {"a": {}}, 0, 3, -1, 1.5, 1e38, 1e300, 10**30, True, ..., *ODD_TEXTS)
BYTES = (*(bytes([number]) for number in range(0, 256, 5)), b"", b"x", b",", b"\n", b'"', b"nan", b"1e999", b"1e300", b"9" * 20)
ARRAYS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    np.transpose, np.zeros_like, lambda a: a[:1], lambda a: a.astype(complex), lambda a: np.full(a.shape, 1e300),
    lambda a: np.full(a.shape, np.nan), lambda a: np.zeros(a.shape, "M8[s]"), lambda a: np.zeros(a.shape, "f4,f4,f4"),
)  # fmt: skip


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


# ---------------------------------------------------------------- by chance
def changed_somewhere(draw: random.Random, suffix: str, content: bytes) -> tuple[bytes, object]:
    """The content of a file with another value in one place, and what that is."""
    if suffix == ".json":
        whole = json.loads(content)
        (*above, last), value = draw.choice([*places(whole)]), draw.choice(JSON)
        part = whole
        for key in above:
            part = part[key]
        part[last] = value
        if value is ...:
            del part[last]
        return json.dumps(whole).encode(), (*above, last, value)
    if suffix in (".npy", ".npz") and draw.random() < 0.7:
        number, stored, written = draw.randrange(len(ARRAYS)), np.load(BytesIO(content)), BytesIO()
        if suffix == ".npy":
            np.save(written, ARRAYS[number](stored))
        else:
            np.savez(written, **{**stored, (name := draw.choice(stored.files)): ARRAYS[number](stored[name])})
        return written.getvalue(), f"array {number}"
    start, new = draw.randrange(len(content)), draw.choice(BYTES)
    end = draw.choice((start, start + len(new), len(content)))
    return content[:start] + new + content[end:], (start, new, end)


def places(content: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The keys of everything inside of JSON; of lists those of the first four."""
    inside = content.items() if isinstance(content, dict) else enumerate(content[:4]) if isinstance(content, list) else ()
    for key, value in inside:
        yield (*place, key)
        yield from places(value, (*place, key))


def word(name: str, old: str, new: str) -> Spoil:
    """A text with ``new`` in the place of ``old``."""
    return lambda folder: (folder / name).write_text((folder / name).read_text().replace(old, new))


def array(name: str, values: np.ndarray) -> Spoil:
    """Other numbers in a file .npy."""
    return lambda folder: np.save(folder / name, values)
