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
    content = read_json(path)
    listed = content.pop("frames", None)
    if isinstance(listed, dict):
        pairs = [
            (f"{path}: frames[{key!r}]", {"key": key, **frame} if isinstance(frame, dict) else frame)
            for key, frame in listed.items()
        ]
    elif isinstance(listed, list):
        pairs = [(f"{path}: frames[{place}]", frame) for place, frame in enumerate(listed)]
    else:
        raise InputError(f"{path}: frames: expected a list, found {type(listed).__name__}")
    if not pairs:
        raise InputError(f"{path}: frames: expected at least one frame, found none")
    for where, frame in pairs:
        if not isinstance(frame, dict):
            raise InputError(f"{where}: expected an object, found {type(frame).__name__}")
    return [(where, {**content, **frame}) for where, frame in pairs]
