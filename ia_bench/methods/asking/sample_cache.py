"""Samples of a prior kept between runs, by the content of everything that decides them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ia_bench.common.atomic_file import whole_file

ABANDONED_SECONDS = 3600.0  # no sample takes so long to be written
CACHE_BYTES = 2 << 30  # the samples used longest ago are removed beyond this


@dataclass(frozen=True)
class StoredSample:
    """One draw: component -> (V, H, W, 3), what it had cost when it was made, and what was counted."""

    sample: dict[str, Tensor]
    seconds: float
    counters: dict[str, int]


def content_key(*parts: str | Tensor) -> str:
    """SHA-256 (hex) over texts and the dtype, shape and bytes of tensors, each delimited."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            digest.update(f"{part.dtype}{tuple(part.shape)}\0".encode())
            digest.update(part.contiguous().numpy().tobytes())
        else:
            digest.update(f"{len(part)}\0{part}".encode())
    return digest.hexdigest()


class SampleCache:
    """Files ``samples-<key>.safetensors`` in one folder; readers see whole files only."""

    def __init__(self, folder: Path, limit: int = CACHE_BYTES) -> None:
        """``limit``: bytes of samples kept in all."""
        self._folder, self._limit = folder, limit

    def load(self, key: str) -> StoredSample | None:
        """The draw kept under ``key``, or None; a file that cannot be read counts as none."""
        path = self._path(key)
        try:
            with safe_open(path, framework="pt") as file:
                about: Mapping[str, str] = file.metadata()
                sample = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
            with contextlib.suppress(OSError):  # of another user
                os.utime(path)  # used just now
            counters = {name: int(count) for name, count in json.loads(about["counters"]).items()}
            return StoredSample(sample, float(about["seconds"]), counters)
        except (OSError, SafetensorError, KeyError, TypeError, ValueError, AttributeError):
            return None

    def store(self, key: str, stored: StoredSample) -> None:
        """Keep a draw, and remove the ones used longest ago beyond the limit. A folder that cannot be written keeps none."""
        path = self._path(key)
        about = {"seconds": repr(stored.seconds), "counters": json.dumps(stored.counters)}
        with contextlib.suppress(OSError, SafetensorError):
            self._folder.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as partial:
                save_file({name: value.contiguous() for name, value in stored.sample.items()}, partial, metadata=about)
            self._trim()

    def _trim(self) -> None:
        for path in self._folder.glob(".samples-*"):  # of a process that was killed while it wrote
            if time.time() - path.stat().st_mtime > ABANDONED_SECONDS:
                path.unlink(missing_ok=True)
        files = sorted(((p.stat(), p) for p in self._folder.glob("samples-*.safetensors")), key=lambda f: -f[0].st_mtime)
        total = 0
        for status, path in files:
            total += status.st_size
            if total > self._limit:
                path.unlink(missing_ok=True)

    def _path(self, key: str) -> Path:
        return self._folder / f"samples-{key[:32]}.safetensors"
