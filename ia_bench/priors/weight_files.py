"""Weights of networks on disk, in files that cannot run code: safetensors in half precision, and what they are as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.settings import parsed

FORMAT = 1
Config = TypeVar("Config")


def read_description(path: Path, kind: type[Config]) -> tuple[Config, dict[str, Any]]:
    """The config of a network, and its provenance, from the JSON file ``path``.

    Raises InputError, naming file and key, where there is none, or one of another format or whose network is no ``kind``.
    """
    if not is_file(path):
        raise InputError(f"{path}: no such file; expected a folder of weights as ia_bench_training writes it")
    described = read_json(path)
    if described.get("format") != FORMAT:
        raise InputError(f"{path}: format: expected {FORMAT}, found {described.get('format')}")
    for key in ("network", "provenance"):
        if not isinstance(described.get(key), dict):
            raise InputError(f"{path}: expected a table under {key!r}, found {described.get(key)!r}")
    try:
        return parsed(kind, described["network"], "network"), described["provenance"]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def fill(module: nn.Module, path: Path) -> None:
    """Put the tensors of the safetensors file ``path`` into ``module``, in float32. All of its own, and no others, must be there.

    Raises InputError, naming file and tensor, for what is missing, damaged, of another shape or not finite.
    """
    try:
        weights = load_file(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: expected safetensors, found a file that cannot be read ({error})") from None
    expected = module.state_dict()
    for name, value in expected.items():
        if name not in weights or weights[name].shape != value.shape:
            found = tuple(weights[name].shape) if name in weights else "none"
            raise InputError(f"{path}: {name}: expected a tensor of shape {tuple(value.shape)}, found {found}")
        if not bool(torch.isfinite(weights[name]).all()):
            raise InputError(f"{path}: {name}: expected finite values, found NaN or Inf")
    left = sorted(set(weights) - set(expected))
    if left:
        raise InputError(f"{path}: {left[0]}: a tensor that the config has no place for")
    module.load_state_dict({name: value.float() for name, value in weights.items()})
