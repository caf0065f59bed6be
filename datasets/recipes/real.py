"""Files of `make real-data`: photographed lights and scanned objects, by the names that datasets/real/sources.toml has."""

import os
from pathlib import Path

import numpy as np
from latlong import mean_luminance
from numpy.typing import NDArray
from photographs import clamp, resample

PREFIX = "real_"
"""Begins the name of every light of lights/NAME.hdr in a recipe."""

FOLDER = Path(os.environ.get("IA_BENCH_REAL_DATA", Path(__file__).resolve().parents[2] / "results" / "real"))


def real_file(name: str) -> Path:
    """The file of that name.

    Raises:
        ValueError: if it is not there; the message says what to do.
    """
    path = FOLDER / name
    if not path.is_file():
        raise ValueError(f"{path}: expected a file of `make real-data`; run that, or say by IA_BENCH_REAL_DATA where it is")
    return path


def real_light(name: str, height: int, brightness: float) -> NDArray[np.float32]:
    """Light (height, 2 height, 3) of the photograph lights/`name`.hdr, resampled and scaled to mean luminance `brightness`."""
    import bpy  # reads Radiance pictures; names of lights are needed where there is no Blender

    image = bpy.data.images.load(str(real_file(f"lights/{name}.hdr")))
    image.colorspace_settings.name = "Non-Color"
    width, rows = image.size
    pixels = np.empty(4 * width * rows, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    light = resample(clamp(pixels.reshape(rows, width, 4)[::-1, :, :3])[0], height)  # Blender's images start at the bottom
    return (light * (brightness / mean_luminance(light))).astype(np.float32)
