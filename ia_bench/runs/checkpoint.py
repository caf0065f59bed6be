"""The file format of checkpoints: a line that says what follows, its checksum, and a state as torch writes it.

Nothing is read from a file whose checksum is another one, or that other code wrote: flipped bits would be resumed to other
numbers, and a state means what the code that wrote it meant. That is the code of this package, of which the file has a hash, and
of plugins, which is part of the configuration's hash (:func:`ia_bench.common.registry.foreign_code`).
"""

from __future__ import annotations

import hashlib
import io
from functools import cache
from pathlib import Path
from typing import Any

from ia_bench.common.errors import first_line
from ia_bench.common.paths import PACKAGE

MAGIC = b"ia_bench checkpoint\n"
DIGEST = 64  # characters of a SHA-256 in hex


class BadCheckpoint(ValueError):
    """A file that is no checkpoint of this run; the message says why."""


def pack(state: dict[str, Any], config_hash: str) -> bytes:
    """The content of a checkpoint file. ``state``: tensors, numbers, texts, lists and dicts."""
    import torch  # readers of results do without it

    buffer = io.BytesIO()
    torch.save({"code": _code(), "config_hash": config_hash, "state": state}, buffer)
    return MAGIC + hashlib.sha256(buffer.getbuffer()).hexdigest().encode() + buffer.getbuffer()


def unpack(path: Path, config_hash: str) -> dict[str, Any]:
    """The state in a checkpoint file. Raises BadCheckpoint for one that is damaged, of another configuration or of other code."""
    import torch

    try:
        content = path.read_bytes()
        start = len(MAGIC) + DIGEST
        if content[:start] != MAGIC + hashlib.sha256(memoryview(content)[start:]).hexdigest().encode():
            raise BadCheckpoint("it is damaged")
        saved = torch.load(io.BytesIO(content[start:]), map_location="cpu", weights_only=True)
        code, owner, state = saved["code"], saved["config_hash"], dict(saved["state"])
    except BadCheckpoint:
        raise
    except Exception as error:  # torch.load raises whatever a file leads it to
        raise BadCheckpoint(f"it cannot be read: {first_line(error)}") from error
    if code != _code():
        raise BadCheckpoint("another version of the code wrote it")
    if owner != config_hash:
        raise BadCheckpoint("it belongs to another configuration")
    return state


@cache
def _code() -> str:
    """Which code writes: a hash of the package's sources, and torch's version."""
    import torch

    digest = hashlib.sha256(torch.__version__.encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
