"""OpenEXR files of the scene folder: how precisely each kind is stored, rounding, atomic writing."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray


@dataclass(frozen=True)
class Storage:
    """How a kind of image is stored, as half floats.

    `bits` are the explicit mantissa bits kept, of ten: the relative error is at most 2^-(bits+1). `step`, if given, rounds
    to multiples of it instead. `level`, if given, is the level of OpenEXR's lossy DWAB, taken where it is worth it.
    """

    bits: int = 10
    step: float | None = None
    level: float | None = None


STORAGE = {
    "light": Storage(bits=8),
    "image": Storage(bits=7, level=100.0),
    "specular": Storage(bits=6, level=100.0),
    "train_specular": Storage(bits=6, level=200.0),
    "albedo": Storage(bits=6),
    "roughness": Storage(bits=6),
    "metallic": Storage(bits=6),
    "normal": Storage(step=1 / 256),
    "depth": Storage(),
}
"""Rounding by 7 or 6 bits errs by at most 0.4 or 0.8 %, normals by 0.2 degrees; rounded depth would move the surface.

DWAB at level 100 stays 45 dB of sRGB above its error, alpha exact; specular images of training views, which only the
oracle sees, are kept at 42 dB. DWAA would decode to the same pixels, but takes a quarter more for images this small.
"""

WORTH_LOSS = 0.9
"""An image is compressed with loss if that takes at most this share of the lossless bytes."""

HALF_MAX = 65504.0


def round_mantissa(values: NDArray[np.floating], bits: int) -> NDArray[np.float16]:
    """Round to `bits` explicit mantissa bits, nearest even, and store as half.

    The relative error is at most 2^-(bits+1); below 2^-14, where halves are evenly spaced, 2^-25 comes on top.
    Zero stays zero; rounding twice changes nothing.

    Raises:
        ValueError: if a value is not finite, or once it is rounded does not fit a half float.
    """
    single = np.ascontiguousarray(values, dtype=np.float32)
    drop = 23 - bits  # rounded in float32, so that the value is rounded once, not twice
    word = single.view(np.uint32)
    even = (word >> np.uint32(drop)) & np.uint32(1)
    word = (word + np.uint32((1 << (drop - 1)) - 1) + even) & ~np.uint32((1 << drop) - 1)
    rounded = word.view(np.float32)
    if not np.isfinite(single).all() or np.abs(rounded).max(initial=0.0) > HALF_MAX:
        raise ValueError(f"values must be finite and at most {HALF_MAX} when rounded, got up to {np.abs(single).max(initial=0.0)}")
    return rounded.astype(np.float16)


def quantise(values: NDArray[np.floating], storage: Storage) -> NDArray[np.float16]:
    """Round as `storage` says; lossy compression comes on top when the image is written."""
    if storage.step is None:
        return round_mantissa(values, storage.bits)
    return round_mantissa(np.rint(values / np.float32(storage.step)) * np.float32(storage.step), storage.bits)


def store(path: Path, values: NDArray[np.floating], kind: str) -> None:
    """Write an image (H, W), (H, W, 3) or (H, W, 4) as its kind in STORAGE says."""
    write_exr(path, quantise(values, STORAGE[kind]), STORAGE[kind].level)


def write_exr(path: Path, image: NDArray[np.float16], level: float | None = None) -> None:
    """Write a half image (H, W) as channel Y, (H, W, 3) as RGB or (H, W, 4) as RGBA; atomically, folders made.

    Lossless, as one tile of the whole image, which ZIP compresses a tenth better than strips of 16 rows; or, given the
    `level` of the loss, as DWAB where that is worth it (not for images of 32 x 32).

    Raises:
        ValueError: if the array is not half or has another shape.
    """
    names = {2: "Y", 3: {3: "RGB", 4: "RGBA"}.get(image.shape[-1])}.get(image.ndim)
    if names is None or image.dtype != np.float16:
        shapes = "(H, W), (H, W, 3) or (H, W, 4)"
        raise ValueError(f"{path}: expected a half image {shapes}, got {image.dtype} {image.shape}")
    planes = image[..., None] if image.ndim == 2 else image
    channels = {name: np.ascontiguousarray(planes[..., i]) for i, name in enumerate(names)}
    tile = OpenEXR.TileDescription()
    tile.ySize, tile.xSize = image.shape[:2]
    headers = [{"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.tiledimage, "tiles": tile}]
    if level is not None:
        lossy = {"compression": OpenEXR.DWAB_COMPRESSION, "dwaCompressionLevel": level}
        headers.append({"type": OpenEXR.scanlineimage} | lossy)
    path.parent.mkdir(parents=True, exist_ok=True)
    candidates = [path.with_name(f".{path.stem}.{os.getpid()}.{i}.exr") for i in range(len(headers))]
    for header, candidate in zip(headers, candidates, strict=True):
        OpenEXR.File(header, channels).write(str(candidate))
    sizes = [candidate.stat().st_size for candidate in candidates]
    candidates[-1 if sizes[-1] < WORTH_LOSS * sizes[0] else 0].replace(path)
    for candidate in candidates:
        candidate.unlink(missing_ok=True)


def read_planes(path: Path) -> dict[str, NDArray[np.float32]]:
    """Every channel (H, W) of an EXR file by its full name, e.g. "ViewLayer.Combined.R"."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}
