"""Radiance pictures (.hdr): three mantissas and a common exponent per pixel, run-length encoded or flat.

A pixel (r, g, b, e) is (r, g, b) 2^(e - 136), black where e is 0 (Ward, "Real Pixels", Graphics Gems II, 1991; file layout:
Radiance's reference manual, "filefmts"). Rows run from top to bottom, which is what all programs write.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, shown
from ia_bench.scenes.exr import expect_size_to_read

SHORTEST, LONGEST = 8, 32767  # pixels of a row that may be run-length encoded


def read_rgbe(path: Path) -> np.ndarray:
    """The picture (H, W, 3) float32, linear. Raises InputError, naming the file, for one that is none or ends too early."""
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such image")
    content = path.read_bytes()
    height, width, place = _header(path, content)
    expect_size_to_read(path, width, height)
    try:
        rows = np.zeros((height, width, 4), np.uint8)
        for row in rows:
            place = _row(content, place, row)
    except (IndexError, ValueError, MemoryError):
        raise InputError(f"{path}: expected {height} rows of {width} pixels, found damaged or missing data") from None
    scale = np.where(rows[..., 3] > 0, np.exp2(rows[..., 3].astype(np.float64) - 136), 0)
    return (rows[..., :3] * scale[..., None]).astype(np.float32)


def _header(path: Path, content: bytes) -> tuple[int, int, int]:
    """Height, width, and where the pixels begin."""
    if not content.startswith(b"#?"):
        raise InputError(f"{path}: expected a Radiance picture, which begins with #?, found {shown(repr(content[:10]))}")
    head, separator, rest = content.partition(b"\n\n")
    size, _, _ = rest.partition(b"\n")
    words = size.split()
    if b"32-bit_rle_xyze" in head:
        raise InputError(f"{path}: expected the colours of 32-bit_rle_rgbe, found 32-bit_rle_xyze")
    if not separator or len(words) != 4 or words[0] != b"-Y" or words[2] != b"+X" or not (words[1] + words[3]).isdigit():
        raise InputError(f"{path}: expected a size as '-Y rows +X columns', found {shown(repr(size[:40]))}")
    return int(words[1]), int(words[3]), len(head) + 2 + len(size) + 1


def _row(content: bytes, place: int, row: np.ndarray) -> int:
    """Fill one ``row`` (W, 4) from ``place`` on and return where the next one begins."""
    width = len(row)
    start = content[place : place + 4]
    encoded = SHORTEST <= width <= LONGEST and start[:2] == b"\x02\x02" and start[2] * 256 + start[3] == width
    if not encoded:
        end = place + 4 * width
        row[:] = np.frombuffer(content[place:end], np.uint8).reshape(width, 4)
        return end
    place += 4
    for channel in range(4):
        column = 0
        while column < width:
            count = content[place]
            if count > 128:  # a run
                length = count - 128
                row[column : column + length, channel] = content[place + 1]
                place += 2
            else:
                length = count
                row[column : column + length, channel] = np.frombuffer(content[place + 1 : place + 1 + length], np.uint8)
                place += 1 + length
            if not length or column + length > width:
                raise ValueError("a run beyond the row")
            column += length
    return place
