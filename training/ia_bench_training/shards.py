"""Files of training images: shards of stacked half-float tensors, written whole or not at all. Needs no renderer.

``shard_00000.safetensors`` holds the images ``first .. first + count - 1`` of one seed, every tensor (N, S, S, C) float16
and linear Rec.709, premultiplied by coverage:

    image       (N, S, S, 4)  radiance; coverage in the last channel
    albedo      (N, S, S, 3)  base colour
    specular    (N, S, S, 3)  specular radiance, direct light only; ``image[..., :3] - specular`` is the diffuse part,
                              one bounce of indirect light included
    normal      (N, S, S, 3)  shading normal in camera space (+x right, +y up, +z toward the camera)
    visibility  (N, S, S, 1)  cosine-weighted visibility of the sky, by the object's own shadowing

Radiance is as lit, its mean over the foreground about 0.3; training chooses exposures of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError

DATA_VERSION = 2
"""Raised whenever the same (seed, index) would render a different image, beyond rounding, in which processors differ too.

Folders of different versions do not mix."""

SHARD_IMAGES = 256
"""Images of a full shard."""

SHARDS = "shard_[0-9]*.safetensors"
"""What finished shards are called."""

CHANNELS = {"image": 4, "albedo": 3, "specular": 3, "normal": 3, "visibility": 1}
"""Tensors of a shard and their last axis."""


@dataclass(frozen=True)
class ShardInfo:
    """Where a shard's images come from.

    Attributes:
        seed: Which of the endless sets.
        first: The index of its first image in that set.
        count: How many images it holds.
        size: Their side in pixels.
        redrawn: How many were drawn again because they were empty, full or not finite.
        version: Version of the program that made them.
    """

    seed: int
    first: int
    count: int
    size: int
    version: int = DATA_VERSION
    redrawn: int = 0


def shard_path(folder: Path, number: int) -> Path:
    """The file of shard ``number``, counted from 0."""
    return folder / f"shard_{number:05d}.safetensors"


def shard_paths(folder: Path) -> list[Path]:
    """The finished shards in ``folder``, in order. Raises InputError if there is none."""
    paths = sorted(folder.glob(SHARDS))
    if not paths:
        raise InputError(f"{folder}: expected shard_*.safetensors (python -m ia_bench_training.prior_data makes them), found none")
    return paths


class Numbers(Protocol):
    """A dataclass of whole numbers, one of which is a version."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def version(self) -> int:
        """That of the program that made what it describes."""
        ...


Info = TypeVar("Info", bound=Numbers)


def write_halves(path: Path, tensors: Mapping[str, Tensor], channels: Iterable[str], info: Numbers) -> None:
    """Write the tensors that ``channels`` name, in half precision, and the numbers of ``info``; whole or not at all."""
    metadata = {name: str(value) for name, value in vars(info).items()}
    with whole_file(path) as partial:
        save_file({name: tensors[name].half().contiguous() for name in channels}, partial, metadata=metadata)


def described(path: Path, kind: type[Info], version: int, what: str) -> Info:
    """The numbers that :func:`write_halves` put beside the tensors, as a ``kind``, which has a version.

    Raises InputError, which calls the file ``what``, for one that is not there, damaged or of another version.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: expected {what}, found no file that can be read ({error})") from None
    try:
        info = kind(**{name: int(metadata[name]) for name in kind.__dataclass_fields__})
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: expected {what}, found no number under {error} in its metadata") from None
    if info.version != version:
        raise InputError(f"{path}: expected {what} of version {version}, found {info.version}; make it again")
    return info


def write_shard(path: Path, tensors: dict[str, Tensor], info: ShardInfo) -> None:
    """Write a shard, whole or not at all."""
    write_halves(path, tensors, CHANNELS, info)


def read_info(path: Path) -> ShardInfo:
    """What a shard says of itself. Raises InputError if it is no shard, or of another version."""
    return described(path, ShardInfo, DATA_VERSION, "a shard of training images")


def load_shard(path: Path) -> tuple[dict[str, Tensor], ShardInfo]:
    """Read a shard: its tensors by name, (N, S, S, C) float16, and where they come from.

    Raises InputError if the file is missing, damaged, of another version, or lacks a tensor or has one of another shape.
    """
    info = read_info(path)
    tensors = {}
    with safe_open(path, framework="pt") as file:
        held = set(file.keys())
        for name, channels in CHANNELS.items():
            if name not in held:
                raise InputError(f"{path}: expected tensors {', '.join(CHANNELS)}, found {', '.join(sorted(held))}")
            tensors[name] = file.get_tensor(name)
            expected = (info.count, info.size, info.size, channels)
            if tuple(tensors[name].shape) != expected or tensors[name].dtype != torch.float16:
                raise InputError(
                    f"{path}: {name}: expected float16 {expected}, found {tensors[name].dtype} {tuple(tensors[name].shape)}"
                )
    return tensors, info
