"""A light as a sum of parts that are rendered apart and added: every bright source, and the rest.

Light is additive, so images of the parts add up to the image of the whole, every bounce included. Cycles picks points on
an environment by luminance alone, whether or not they are above the horizon of the surface; where several sources
compete, that choice is most of the noise, and a part has nothing to choose.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from exr import read_planes, write_exr
from latlong import LUMINANCE, mean_luminance, solid_angles
from numpy.typing import NDArray

BRIGHT = 5.0
"""A texel belongs to a bright source where its luminance is this many times the light's mean."""


@dataclass(frozen=True)
class Part:
    """A part of a light: its lat-long EXR file, and how much of the samples it gets (the shares of a light sum to 1)."""

    path: Path
    share: float


def split(light: NDArray[np.floating], least_power: float) -> list[NDArray[np.floating]]:
    """Parts (H, 2H, 3) of a light (H, 2H, 3) that sum to it exactly: the rest first, then the bright sources.

    Sources with a smaller share of the light's power than `least_power` stay in the rest.
    """
    power = (light.astype(np.float64) @ LUMINANCE) * solid_angles(light.shape[0])
    labels = connected(light.astype(np.float64) @ LUMINANCE > BRIGHT * mean_luminance(light))
    bright = [labels == label for label in range(1, labels.max() + 1)]
    bright = [source for source in bright if power[source].sum() > least_power * power.sum()]
    rest = ~np.any(bright, axis=0) if bright else np.ones_like(labels, dtype=bool)
    return [np.where(texels[..., None], light, 0).astype(light.dtype) for texels in (rest, *bright) if power[texels].any()]


def connected(texels: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Label (H, W) of each connected region of `texels` (H, W), 1, 2, ...; 0 elsewhere.

    Texels that touch at an edge or a corner are connected; the first column touches the last.
    """
    labels = np.where(texels, np.arange(1, texels.size + 1).reshape(texels.shape), 0)
    while True:  # every region takes its largest label, one ring of texels a round
        padded = np.pad(np.pad(labels, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)))
        largest = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
        grown = np.where(texels, largest, 0)
        if np.array_equal(grown, labels):
            return np.unique(np.append(0, labels.ravel()), return_inverse=True)[1][1:].reshape(texels.shape)
        labels = grown


def write_parts(light: Path, folder: Path, least_power: float) -> list[Path]:
    """Split the light of an EXR file into files in `folder`; their paths, in the order of `split`."""
    planes = read_planes(light)
    parts = split(np.stack([planes[name] for name in "RGB"], axis=-1), least_power)
    paths = [folder / f"{light.stem}_{index}.exr" for index in range(len(parts))]
    for path, part in zip(paths, parts, strict=True):
        write_exr(path, part.astype(np.float16))  # exact: the file held halves
    return paths
