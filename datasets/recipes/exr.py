"""OpenEXR files of the scene folder: rounding to fewer mantissa bits, atomic writing."""

import os
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

MANTISSA_BITS = 8
"""Explicit mantissa bits that shipped radiance keeps (half floats have 10): relative step 2^-8, error at most 0.2 %."""

HALF_MAX = 65504.0


def round_mantissa(values: NDArray[np.floating], bits: int = MANTISSA_BITS) -> NDArray[np.float16]:
    """Round to `bits` explicit mantissa bits, nearest even, and store as half.

    The relative error is at most 2^-(bits+1) for normal halves (magnitude at least 2^-14), the absolute one at most
    2^-25 below. Zero stays zero; rounding twice changes nothing.

    Raises:
        ValueError: if a value is not finite or does not fit a half float.
    """
    single = np.ascontiguousarray(values, dtype=np.float32)
    if not np.isfinite(single).all() or np.abs(single).max(initial=0.0) >= HALF_MAX:
        raise ValueError(f"values must be finite and below {HALF_MAX}, got up to {np.abs(single).max(initial=0.0)}")
    drop = 23 - bits  # rounded in float32, so that the value is rounded once, not twice
    word = single.view(np.uint32)
    even = (word >> np.uint32(drop)) & np.uint32(1)
    word = (word + np.uint32((1 << (drop - 1)) - 1) + even) & ~np.uint32((1 << drop) - 1)
    return word.view(np.float32).astype(np.float16)


def write_exr(path: Path, image: NDArray[np.float16]) -> None:
    """Write a half image (H, W) as channel Y, (H, W, 3) as RGB or (H, W, 4) as RGBA; atomically, folders made.

    Raises:
        ValueError: if the array is not half or has another shape.
    """
    names = {2: "Y", 3: {3: "RGB", 4: "RGBA"}.get(image.shape[-1])}.get(image.ndim)
    if names is None or image.dtype != np.float16:
        raise ValueError(f"{path}: expected a half image (H, W), (H, W, 3) or (H, W, 4), got {image.dtype} {image.shape}")
    planes = image[..., None] if image.ndim == 2 else image
    channels = {name: np.ascontiguousarray(planes[..., i]) for i, name in enumerate(names)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.exr")
    path.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(header, channels).write(str(temporary))
    temporary.replace(path)


def read_planes(path: Path) -> dict[str, NDArray[np.float32]]:
    """Every channel (H, W) of an EXR file by its full name, e.g. "ViewLayer.Combined.R"."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}
