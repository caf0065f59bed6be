"""Weights of networks, from safetensors files, which cannot run code, into modules."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from ia_bench.common.errors import InputError


def content_hash(files: Iterable[Path]) -> str:
    """SHA-256 (hex) over the names and contents of those ``files`` that exist."""
    digest = hashlib.sha256()
    for path in files:
        if path.is_file():
            status = path.stat()
            digest.update(path.name.encode() + _file_digest(path, status.st_size, status.st_mtime_ns))
    return digest.hexdigest()


@functools.lru_cache(maxsize=32)
def _file_digest(path: Path, size: int, modified: int) -> bytes:
    """SHA-256 of a file of this ``size``, ``modified`` then. It is kept, because every draw asks for it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def fill(module: torch.nn.Module, path: Path, expected: dict[str, Tensor]) -> None:
    """Put the tensors of the file ``path`` into ``module``, in float32. Those ``expected``, and no others, must be there.

    Raises InputError, naming file and tensor, for what is missing, damaged, of another shape or not finite.
    """
    try:
        weights = load_file(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: expected safetensors, found a file that cannot be read ({error})") from None
    for name, value in expected.items():
        if name not in weights:
            raise InputError(f"{path}: {name}: expected a tensor {tuple(value.shape)}, found none")
        if weights[name].shape != value.shape:
            raise InputError(f"{path}: {name}: expected shape {tuple(value.shape)}, found {tuple(weights[name].shape)}")
        if not bool(torch.isfinite(weights[name]).all()):
            raise InputError(f"{path}: {name}: expected finite values, found NaN or Inf")
    left = sorted(set(weights) - set(expected))
    if left:
        raise InputError(f"{path}: {left[0]}: a tensor that the config has no place for")
    module.load_state_dict({name: value.float() for name, value in weights.items()}, strict=False)
