"""Files of fits of procedural scenes, from which the refiner learns: what a fit recovered in some photographs, and the truth.

``fit_0_00012.safetensors`` is fit 12 of seed 0. Tensors (V, S, S, C) float16, linear Rec.709, premultiplied by coverage:

    image           (V, S, S, 4)  the photograph as the fit saw it; coverage in the last channel
    albedo          (V, S, S, 3)  the albedo that was recovered
    roughness       (V, S, S, 1)  the perceptual roughness that was recovered
    radiance        (V, S, S, 3)  the photograph as the fit renders it
    specular        (V, S, S, 3)  the specular shading in it
    evidence        (V, S, S, 2)  what the photographs together say about a place (``methods.regularisers.refiner.evidence``)
    normal          (V, S, S, 3)  shading normal in camera space
    visibility      (V, S, S, 1)  cosine-weighted visibility of the sky
    view_count       (V, S, S, 1)  how many photographs show the place
    true_albedo     (V, S, S, 3)
    true_roughness  (V, S, S, 1)

The evidence is that of all photographs of the fit, of which the file shows some. In a run it is that of the photographs that the
prior is asked about, which prior.views says.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import safe_open
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench_training.shards import described, write_halves

FITS_VERSION = 2
"""Raised whenever the same (seed, index) would make another scene or fit, beyond rounding."""

CHANNELS = {
    "image": 4, "albedo": 3, "roughness": 1, "radiance": 3, "specular": 3, "evidence": 2, "normal": 3,
    "visibility": 1, "view_count": 1, "true_albedo": 3, "true_roughness": 1,
}  # fmt: skip
"""Tensors of a file and their last axis."""

_NAME = re.compile(r"fit_(\d+)_(\d+)\.safetensors")


@dataclass(frozen=True)
class FitInfo:
    """Where a fit comes from.

    Attributes:
        seed: Which of the endless sets.
        photographs: How many it had; the file shows some of them.
        version: Version of the program that made it.
    """

    seed: int
    photographs: int
    version: int = FITS_VERSION


def fit_path(folder: Path, seed: int, index: int) -> Path:
    """The file of fit ``index`` of ``seed``."""
    return folder / f"fit_{seed}_{index:05d}.safetensors"


def fit_paths(folder: Path) -> list[Path]:
    """The finished fits in ``folder``, by seed and number. Raises InputError if there is none."""
    found = [(tuple(map(int, match.groups())), path) for path in folder.glob("*") if (match := _NAME.fullmatch(path.name))]
    if not found:
        raise InputError(f"{folder}: expected fit_*.safetensors (python -m ia_bench_training.fit_data makes them), found none")
    return [path for _, path in sorted(found)]


def write_fit(path: Path, tensors: dict[str, Tensor], info: FitInfo) -> None:
    """Write a fit, whole or not at all."""
    write_halves(path, tensors, CHANNELS, info)


def load_fit(path: Path) -> tuple[dict[str, Tensor], FitInfo]:
    """Read a fit: its tensors by name, float16, and where it comes from.

    Raises InputError if the file is damaged, of another version, or lacks a tensor or has one of another shape.
    """
    info = described(path, FitInfo, FITS_VERSION, "a fit of a procedural scene")
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
    shape = tuple(tensors["image"].shape[:3]) if "image" in tensors and tensors["image"].ndim == 4 else None
    for name, channels in CHANNELS.items():
        found = tuple(tensors[name].shape) if name in tensors else "none"
        if shape is None or found != (*shape, channels) or tensors[name].dtype != torch.float16:
            raise InputError(f"{path}: {name}: expected float16 (V, S, S, {channels}), found {found}")
    return tensors, info
