"""Tensors kept between runs, by the content of everything that decides them: bakes of a mesh, samples of a prior.

A cache is a convenience. One that cannot be used (full, read-only, no folder, damaged or foreign files) stops nothing: what
would be kept is made again, and the user is told once.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ia_bench.common.atomic_file import whole_file

ROUNDING = 1  # part of every key; raised when a change of the code gives all that is kept other last digits
CACHE_BYTES = 4 << 30  # what was used longest ago is removed beyond this


def cache_folder() -> Path:
    """Where things are kept: ``$IA_BENCH_CACHE``, or ``ia_bench`` in the user's cache folder."""
    chosen, base = os.environ.get("IA_BENCH_CACHE"), os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(chosen) if chosen else Path(base or Path.home() / ".cache") / "ia_bench"
    except RuntimeError:  # a user without a home, as in containers
        return Path(tempfile.gettempdir()) / "ia_bench"


def content_key(kind: str, *parts: str | Tensor | np.ndarray) -> str:
    """``kind`` and a hash over texts and the dtype, shape and bytes of arrays, each delimited."""
    digest = hashlib.sha256(f"{ROUNDING}\0".encode())
    for part in parts:
        if isinstance(part, str):
            digest.update(f"{len(part)}\0{part}".encode())
            continue
        array = np.ascontiguousarray(part.numpy() if isinstance(part, Tensor) else part)
        digest.update(f"{array.dtype}{array.shape}\0".encode() + array.tobytes())
    return f"{kind}-{digest.hexdigest()[:32]}"


def made_on(device: str, kind: str) -> str:
    """The ``kind`` of a key of what a device of that type makes: no other one makes it to the last bit.

    What the CPU makes must not depend on whether a GPU has been at work before.
    """
    return kind if device == "cpu" else f"{kind}-{device}"


class Cache:
    """Files ``<key>.safetensors`` in one folder, ``limit`` bytes in all; readers see whole files only."""

    def __init__(self, folder: Path | None = None, limit: int = CACHE_BYTES) -> None:
        """``folder``: None for the user's."""
        self._folder, self._limit = folder or cache_folder(), limit

    def get(self, key: str) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors and JSON values kept under ``key``, or None; a file that is not as it was written counts as none."""
        path = self._folder / f"{key}.safetensors"
        try:
            if not path.exists():
                return None
            with safe_open(path, framework="pt") as file:
                written: Mapping[str, str] = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
            if written.get("content") != _content(key, tensors, written.get("about", "")):
                raise SafetensorError("its content has changed")
            with contextlib.suppress(OSError):  # of another user
                os.utime(path)  # used just now
            return tensors, json.loads(written["about"])
        except (OSError, SafetensorError) as error:
            tell_once(f"{path}: cannot be read ({error}); what it should hold is made again")
            return None

    def put(self, key: str, tensors: Mapping[str, Tensor], about: Mapping[str, Any] | None = None) -> None:
        """Keep tensors (on the CPU) and JSON values, and remove what was used longest ago beyond the limit."""
        kept = {name: tensor.contiguous() for name, tensor in tensors.items()}
        text = json.dumps(about or {})
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with whole_file(self._folder / f"{key}.safetensors") as partial:
                save_file(kept, partial, metadata={"about": text, "content": _content(key, kept, text)})
        except (OSError, SafetensorError) as error:
            why = (isinstance(error, OSError) and error.strerror) or error  # not the partial file, whose name is never the same
            tell_once(f"{self._folder}: nothing can be kept there ({why}); set IA_BENCH_CACHE to a folder that can be written")
            return
        total = 0
        with contextlib.suppress(OSError):  # another process may remove the same
            sizes = {path: path.stat() for path in self._folder.glob("*.safetensors")}
            for path in sorted(sizes, key=lambda path: -sizes[path].st_mtime):
                total += sizes[path].st_size
                if total > self._limit:
                    path.unlink(missing_ok=True)

    def kept(self, key: str, make: Callable[[], Mapping[str, Tensor]]) -> dict[str, Tensor]:
        """What :meth:`get` finds, or else what ``make`` makes, which is kept."""
        found = self.get(key)
        if found is not None:
            return found[0]
        tensors = dict(make())
        self.put(key, tensors)
        return tensors


def _content(key: str, tensors: Mapping[str, Tensor], about: str) -> str:
    return content_key(key, about, *(part for name in sorted(tensors) for part in (name, tensors[name])))


@functools.cache
def tell_once(message: str) -> None:
    """Say that something cannot be kept, however often it is tried."""
    print(f"ia_bench: cache: {message}", file=sys.stderr)
