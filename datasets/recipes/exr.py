"""OpenEXR files of the scene folder: rounding to fewer mantissa bits, atomic writing."""

import os
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

STORED_BITS = {"light": 8, "image": 7, "albedo": 6, "specular": 6, "roughness": 6, "normal": 8, "depth": 10}
"""Explicit mantissa bits kept per kind (halves have 10): with b bits the relative error is at most 2^-(b+1).

Images and specular carry some per cent of Monte Carlo noise, so 0.4 and 0.8 % cost nothing and save a quarter of the
bytes. Depth keeps all bits: rounding would move the surface.
"""

DWA_LEVEL = 100.0
"""OpenEXR's lossy DWAA level for images and specular: 45 dB of sRGB against the exact file, about the renders' own noise.

Alpha stays exact. Everything else is ZIP, lossless, and so is an image for which DWAA is no smaller.
"""

HALF_MAX = 65504.0


def round_mantissa(values: NDArray[np.floating], bits: int) -> NDArray[np.float16]:
    """Round to `bits` explicit mantissa bits, nearest even, and store as half.

    The relative error is at most 2^-(bits+1); below 2^-14, where halves are evenly spaced, 2^-25 comes on top.
    Zero stays zero; rounding twice changes nothing.

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


def write_exr(path: Path, image: NDArray[np.float16], *, lossy: bool = False) -> None:
    """Write a half image (H, W) as channel Y, (H, W, 3) as RGB or (H, W, 4) as RGBA; atomically, folders made.

    `lossy` takes DWAA at DWA_LEVEL instead of ZIP where that is smaller.

    Raises:
        ValueError: if the array is not half or has another shape.
    """
    names = {2: "Y", 3: {3: "RGB", 4: "RGBA"}.get(image.shape[-1])}.get(image.ndim)
    if names is None or image.dtype != np.float16:
        shapes = "(H, W), (H, W, 3) or (H, W, 4)"
        raise ValueError(f"{path}: expected a half image {shapes}, got {image.dtype} {image.shape}")
    planes = image[..., None] if image.ndim == 2 else image
    channels = {name: np.ascontiguousarray(planes[..., i]) for i, name in enumerate(names)}
    headers = [{"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}]
    if lossy:
        headers.append(headers[0] | {"compression": OpenEXR.DWAA_COMPRESSION, "dwaCompressionLevel": DWA_LEVEL})
    path.parent.mkdir(parents=True, exist_ok=True)
    candidates = [path.with_name(f".{path.stem}.{os.getpid()}.{i}.exr") for i in range(len(headers))]
    for header, candidate in zip(headers, candidates, strict=True):
        OpenEXR.File(header, channels).write(str(candidate))
    smallest = min(candidates, key=lambda candidate: candidate.stat().st_size)
    smallest.replace(path)
    for candidate in candidates:
        candidate.unlink(missing_ok=True)


def read_planes(path: Path) -> dict[str, NDArray[np.float32]]:
    """Every channel (H, W) of an EXR file by its full name, e.g. "ViewLayer.Combined.R"."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}
