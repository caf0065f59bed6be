"""Read a checkpoint of PyTorch Lightning without running anything that is in it.

Such a file is a zip archive of raw tensors and of one pickle that says which is which, and a pickle may call whatever it
names. Here the pickle may name what torch's ``weights_only`` reader allows (rebuilding of tensors, plain containers) and
the two names by which Lightning's counters come as numpy scalars, which are answered by stand-ins that compute nothing.
Anything else is refused, by name, before a single instruction of the pickle is followed.
"""

from __future__ import annotations

import hashlib
import pickle
import zipfile
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor
from torch.serialization import get_unsafe_globals_in_checkpoint, safe_globals

from ia_bench.common.errors import InputError


class _Ignored:
    """Stands for a numpy scalar or its type: takes any arguments and any state, and keeps none."""

    def __init__(self, *_: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...


STAND_INS = [(_Ignored, name) for name in ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "numpy.dtype")]
"""The only names beyond torch's own that a checkpoint may use. Both spellings of numpy 1 and 2; only optimiser and
callback states hold such numbers, which are not read."""


class Checkpoint:
    """The tensors of a checkpoint's ``state_dict`` by key, mapped from the file: none is in memory before it is used."""

    def __init__(self, path: Path, tensors: dict[str, Tensor]) -> None:
        self.path = path
        self._tensors = tensors

    def __contains__(self, key: str) -> bool:
        return key in self._tensors

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def tensor(self, key: str) -> Tensor:
        """The tensor of that key. Raises InputError naming file and key."""
        if key not in self._tensors:
            raise InputError(f"{self.path}: expected a tensor {key}, found none of that name among {len(self._tensors)}")
        return self._tensors[key]

    def size(self, key: str, axis: int) -> int:
        """Length of one axis of a tensor. Raises InputError naming file and key."""
        shape = tuple(self.tensor(key).shape)
        if axis >= len(shape):
            raise InputError(f"{self.path}: {key}: expected at least {axis + 1} axes, found shape {shape}")
        return shape[axis]


def sha256(path: Path) -> str:
    """SHA-256 (hex) of a file's content. Raises InputError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def open_checkpoint(path: Path) -> Checkpoint:
    """The tensors of the Lightning checkpoint ``path``, on the CPU and mapped, whatever device they were saved from.

    Raises InputError, naming the file, for one that is cut off or in another format, whose pickle names anything beyond
    the allowed, or that holds no ``state_dict`` of tensors.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if not zipfile.is_zipfile(path):
        size = path.stat().st_size
        raise InputError(f"{path}: expected a whole checkpoint of torch >= 1.6 (a zip archive), found {size} bytes without "
                         "the directory that ends one: the file is cut off, or of another kind")  # fmt: skip
    try:
        with safe_globals(STAND_INS):  # type: ignore[arg-type]  # its annotation lacks the pairs that its text describes
            foreign = sorted(get_unsafe_globals_in_checkpoint(str(path)))
            if foreign:
                raise InputError(f"{path}: refused: expected nothing but tensors and numbers, found a pickle that asks for "
                                 f"{', '.join(foreign)}")  # fmt: skip
            content = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except (pickle.UnpicklingError, RuntimeError, ValueError, EOFError, LookupError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        reason = str(error).strip().splitlines()
        raise InputError(f"{path}: cannot be read as a checkpoint: {reason[0] if reason else type(error).__name__}") from None
    tensors = content.get("state_dict") if isinstance(content, dict) else None
    if not isinstance(tensors, dict):
        found = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise InputError(f"{path}: expected a Lightning checkpoint with the key state_dict, found {found or 'no keys'}")
    for key, value in tensors.items():
        if not isinstance(value, Tensor):
            raise InputError(f"{path}: state_dict.{key}: expected a tensor, found {type(value).__name__}")
    return Checkpoint(path, tensors)
