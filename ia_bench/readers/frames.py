"""The list of frames in a file like NeRF's transforms.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json

Frame = tuple[str, Mapping[str, Any]]
"""How messages name a frame, and what is said of it."""


def frames_of(path: Path) -> list[Frame]:
    """Every frame of the file, completed by what the file says of all of them, and how messages name it.

    ``frames`` is a list, or an object whose keys number or name its frames. Raises InputError.
    """
    return frames_in(path, read_json(path))


def frames_in(path: Path, content: Mapping[str, Any]) -> list[Frame]:
    """The frames of :func:`frames_of`, where the ``content`` of the file is there already."""
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
