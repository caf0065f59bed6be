"""Weights of networks on disk, in files that cannot run code: safetensors in half precision, and what they are as JSON."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.settings import parsed

FORMAT = 1
Config = TypeVar("Config")


def save_weights(
    folder: Path,
    description: str,
    config: Any,  # noqa: ANN401 (a dataclass)
    modules: Mapping[str, nn.Module],
    provenance: Mapping[str, Any],
    more: Callable[[Path], object] = lambda folder: None,
) -> None:
    """Write ``modules``, by the file that holds each, to ``folder``; an older version there is replaced whole.

    ``description``: name of the JSON file with the network's ``config`` and its ``provenance`` (data, steps, seconds, machine,
    figures). ``more`` writes whatever else belongs there, into the folder that it is given.
    """
    partial, old = (folder.with_name(f".{folder.name}.{what}") for what in ("partial", "old"))
    shutil.rmtree(partial, ignore_errors=True)
    for name, module in modules.items():
        (partial / name).parent.mkdir(parents=True, exist_ok=True)
        save_file({key: value.half().contiguous() for key, value in module.state_dict().items()}, partial / name)
    more(partial)
    described = {"format": FORMAT, "network": dataclasses.asdict(config), "provenance": provenance}
    (partial / description).write_text(json.dumps(described, indent=2) + "\n")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        os.replace(folder, old)
    os.replace(partial, folder)
    shutil.rmtree(old, ignore_errors=True)


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


def content_hash(files: Iterable[Path]) -> str:
    """SHA-256 (hex) over the names and contents of those ``files`` that exist."""
    digest = hashlib.sha256()
    for path in files:
        if path.is_file():
            digest.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
