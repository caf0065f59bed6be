"""Pack pictures into files that a page from disk can use: sheets as WebP, errors as numbers within a script."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

TILE = 128  # pixels along a side of a picture on a sheet, at most
ERROR_TILE = 64  # the same of an error, which is a mean over what a pixel of it covers
COLUMNS = 5
LEVELS = 48  # of an error, evenly spaced in its square root
LARGEST = 0.5  # error that the last level stands for
OUTSIDE = 255  # a pixel of an error map that is not scored
PICTURE_QUALITY = 64
EFFORT = 75  # of a lossless picture: 100 takes twelve times as long for 4 % fewer bytes
SMALL = 64  # pixels along a side of a picture that would lose its colours, which a lossy WebP halves in size


def sheet(pictures: Sequence[np.ndarray]) -> bytes:
    """Pictures of one shape (H, W, 3) in [0, 1], in rows of COLUMNS, as one WebP."""
    tiles = [_smaller(np.round(255 * picture).astype(np.uint8)) for picture in pictures]
    height, width, _ = tiles[0].shape
    columns = min(COLUMNS, len(tiles))
    whole = np.zeros((-(-len(tiles) // columns) * height, columns * width, 3), np.uint8)
    for place, tile in enumerate(tiles):
        top, left = place // columns * height, place % columns * width
        whole[top : top + height, left : left + width] = tile
    return webp(Image.fromarray(whole), quality=PICTURE_QUALITY, lossless=height <= SMALL)


def error_map(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root of the mean squared difference over channels and over the scored pixels that a coarser pixel covers.

    Args:
        predicted: (S, S, C) in [0, 1].
        true: The same.
        mask: (S, S), True where scored.

    Returns:
        (s, s) levels from 0 to LEVELS - 1, OUTSIDE where nothing is scored; s is S over the least whole number that
        makes it no more than ERROR_TILE.
    """
    squares = ((predicted - true) ** 2).mean(-1) * mask
    step = -(-len(mask) // ERROR_TILE)
    over = -len(mask) % step
    blocks = [np.pad(part, ((0, over), (0, over))).reshape((len(mask) + over) // step, step, -1, step) for part in (squares, mask)]
    total, count = (part.sum((1, 3)) for part in blocks)
    error = np.sqrt(total / np.maximum(count, 1))
    levels = np.round((LEVELS - 1) * np.sqrt(error.clip(0, LARGEST) / LARGEST))
    return np.where(count > 0, levels, OUTSIDE).astype(np.uint8)


def error_sheet(maps: Sequence[np.ndarray]) -> str:
    """Error maps below each other as a lossless WebP, for a script: a page from disk may not read pixels of other files."""
    return data_url("image/webp", webp(Image.fromarray(np.concatenate(maps)), lossless=True))


def webp(image: Image.Image, *, quality: int = EFFORT, lossless: bool = False) -> bytes:
    """A WebP; the ``quality`` of a lossless one is the effort that the encoder makes."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=quality, lossless=lossless, method=6, exact=False)
    return buffer.getvalue()


def data_url(kind: str, content: bytes) -> str:
    """Bytes as an address that needs no file."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def compact(content: object) -> str:
    """JSON without a blank that nobody reads."""
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def script(name: str, content: dict[str, Any]) -> bytes:
    """A script that hands ``content`` to the page under a name."""
    return f"bench.receive({compact(name)},{compact(content)});\n".encode()


def _smaller(picture: np.ndarray) -> np.ndarray:
    """At most TILE pixels high; a wide one keeps its shape."""
    if picture.shape[0] <= TILE:
        return picture
    size = round(picture.shape[1] * TILE / picture.shape[0]), TILE
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
