"""Environment maps of other people's data, in the layout of :mod:`ia_bench.light.latlong`.

Blender's world texture, and with it every renderer of NeRFactor, TensoIR-Synthetic and Synthetic4Relight, lays a map out as
we do: row 0 is +z (up), the middle column is +x, and the azimuth falls from left to right. Others are looked up direction by
direction (:func:`resampled`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from ia_bench.common.errors import InputError
from ia_bench.common.files import user_path
from ia_bench.light.latlong import texel_centres
from ia_bench.scenes.exr import read_exr, refuse_negative
from ia_bench.scenes.rgbe import read_rgbe
from ia_bench.scenes.scene import Truth, View

SUFFIXES = (".exr", ".hdr")


def read_light(path: Path) -> np.ndarray:
    """The map (H, 2H, 3) float32 of an OpenEXR or Radiance file; what rounding left below 0 is set to 0. Raises InputError."""
    radiance = read_rgbe(path) if path.suffix.lower() == ".hdr" else read_exr(path, 3)
    height, width = radiance.shape[:2]
    if width != 2 * height:
        raise InputError(f"{path}: expected a lat-long map, twice as wide as high, found {width} x {height}")
    refuse_negative(path, radiance)
    return radiance.clip(min=0)


def maps_below(folder: str | None, novel: Sequence[View], notes: list[str], own: str, strength: float = 1.0) -> Truth:
    """The maps of all lights that ``reader.options.lights`` holds as NAME.exr or NAME.hdr; ``notes`` are told of the rest.

    Those are the training light, called ``own`` ("" for none) and multiplied by ``strength``, and the lights of ``novel`` views.

    Raises InputError for a folder that is not there, or that holds none of them.
    """
    wanted = [*([own] if own else []), *sorted({view.light for view in novel} - {"train", own})]
    if folder is None:
        notes += ["no environment maps: reader.options.lights names no folder, so nothing can be relit"] if wanted else []
        return Truth({})
    place = user_path("reader.options.lights", folder, folder=True)
    files = {name: path for name in wanted for suffix in SUFFIXES if (path := place / f"{name}{suffix}").is_file()}
    missing = [name for name in wanted if name not in files]
    if missing and not files:
        there = ", ".join(sorted(path.name for path in place.iterdir())[:8]) or "no file"
        raise InputError(f"{place}: expected environment maps {', '.join(wanted)} (.exr or .hdr), found {there}")
    notes += [f"no environment map of {', '.join(missing)} in {place}"] if missing else []
    lights = {"train" if name == own else name: read_light(path) for name, path in files.items()}
    if "train" in lights and strength != 1:
        with np.errstate(over="ignore"):  # which the check of a scene's lights refuses
            lights["train"] = (strength * lights["train"]).astype(np.float32)
    return Truth(lights)


def resampled(radiance: np.ndarray, look_up: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """A map in another layout, of the same size, in ours: bilinear between the centres of its texels.

    ``look_up`` takes unit directions (H, 2H, 3) of the world and returns where the other map has them, u from its left to its
    right edge and v from its top to its bottom edge, both in [0, 1].
    """
    height, width = radiance.shape[:2]
    u, v = look_up(texel_centres(height, width).double().numpy())
    column, row = u * width - 0.5, (v * height - 0.5).clip(0, height - 1)
    padded = np.concatenate([radiance[:, -1:], radiance, radiance[:, :1]], 1)  # around the sphere
    channels = [map_coordinates(padded[..., c], [row, column % width + 1], order=1, mode="nearest") for c in range(3)]
    return np.stack(channels, -1).astype(np.float32)
