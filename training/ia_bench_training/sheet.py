"""A contact sheet of training images: image, albedo, specular, normal and visibility below each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from torch import Tensor

from ia_bench.common.atomic_file import whole_file
from ia_bench.scenes.color import linear_to_srgb
from ia_bench_training.shards import CHANNELS

COLUMNS = 12
_GREY = 0.2  # linear, behind the object


def contact_sheet(path: Path, tensors: dict[str, Tensor], chosen: list[int]) -> None:
    """Write a PNG of the ``chosen`` images at twice their size, COLUMNS side by side, display-encoded over grey."""
    rows = []
    for start in range(0, len(chosen), COLUMNS):
        part = chosen[start : start + COLUMNS]
        part = part + part[:1] * (COLUMNS - len(part))
        coverage = tensors["image"][part][..., 3:].float().numpy()
        for name in CHANNELS:
            rows.append(np.concatenate(list(_encode(name, tensors[name][part].float().numpy(), coverage)), 1))
    picture = np.concatenate(rows, 0).repeat(2, 0).repeat(2, 1)
    with whole_file(path) as partial:
        Image.fromarray(picture).save(partial)


def _encode(name: str, values: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    values = np.broadcast_to(values[..., :3] if values.shape[-1] > 1 else values, (*values.shape[:-1], 3))
    shown = 0.5 * values + 0.5 if name == "normal" else linear_to_srgb((values + (1 - coverage) * _GREY).clip(0, 1))
    return np.asarray(shown * 255 + 0.5).clip(0, 255).astype(np.uint8)
