"""OpenEXR and Radiance images as float32 arrays, with the checks that every reader wants."""

from __future__ import annotations

import errno
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import numpy as np
import OpenEXR

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, shown

RINGING = 0.01  # lossy compression undershoots beside highlights; more than this share of the maximum is no radiance

MAX_PIXELS = 1 << 26
"""Largest image: 8192 x 8192. A larger one would fill the memory, and a header that promises more is most likely damaged."""

BRIGHTEST = 1e12  # radiance, in whatever unit: squares of more than it leave the range of float32
REC709, ALIKE = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), 0.01  # x and y of red, green, blue, white; rounded by writers
RADIANCE = (0.64, 0.33, 0.29, 0.6, 0.15, 0.06, 1 / 3, 1 / 3)  # what .hdr files say that were never converted: taken for Rec.709


def expect_size_to_read(path: Path, width: int, height: int) -> None:
    """Raise InputError for an image that is too large; what its header says is asked before pixels are read."""
    if width * height > MAX_PIXELS:
        raise InputError(f"{path}: expected at most {MAX_PIXELS} pixels (8192 x 8192), found {width} x {height}; make it smaller")


def read_exr(path: Path, channels: int | None, *, grey: bool = False) -> np.ndarray:
    """Read ``channels`` of an image (1: Y, 3: RGB, 4: RGBA; None: RGBA where it has alpha, else RGB) as (H, W, channels) float32.

    ``grey``: None may also be Y, of an image without red.

    The image is as large as the display window; where the data window has less, as renderers crop what is empty, it is 0.
    Raises InputError, naming the file, when it is missing, unreadable, of another channel layout, or holds NaN or Inf.
    """
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such image")
    if path.suffix.lower() != ".exr":
        kind = path.suffix or "suffixless"
        raise InputError(f"{path}: expected linear values in OpenEXR (.exr; of a light also Radiance, .hdr), found a {kind} file")
    said = StringIO()  # what it prints of a damaged file, and does not raise
    try:
        with redirect_stdout(said), OpenEXR.File(str(path), header_only=True) as file:
            stored, window = (np.array(file.header()[key], int) for key in ("dataWindow", "displayWindow"))
        for first, last in (stored, window):
            expect_size_to_read(path, *(last - first + 1).tolist())
        with redirect_stdout(said), OpenEXR.File(str(path), separate_channels=True) as file:
            found = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable OpenEXR file ({' '.join(said.getvalue().split()) or error})") from None
    names = {1: "Y", 3: "RGB", 4: "RGBA"}[channels or (1 if grey and "R" not in found else 4 if "A" in found else 3)]
    missing = [name for name in names if name not in found]
    if missing:
        raise InputError(f"{path}: expected channels {', '.join(names)}, found {', '.join(sorted(found))}")
    if any(found[name].dtype == object for name in names):
        raise InputError(f"{path}: expected one value in a pixel, found several (a deep image); flatten it")
    if len(sizes := {found[name].shape for name in names}) > 1:
        raise InputError(f"{path}: expected channels of one size, found {' and '.join(map(str, sorted(sizes)))}")
    image = np.stack([found[name] for name in names], axis=-1).astype(np.float32)
    if not np.array_equal(stored, window):
        image = _in_window(image, stored, window)
    if not np.isfinite(image).all():
        row, column = np.argwhere(~np.isfinite(image).all(axis=-1))[0]
        bad = int((~np.isfinite(image)).any(axis=-1).sum())
        raise InputError(f"{path}: {bad} pixel(s) are NaN or Inf, the first at row {row}, column {column}")
    return image


def _in_window(image: np.ndarray, stored: np.ndarray, window: np.ndarray) -> np.ndarray:
    """An image whose pixels lie in the window ``stored``, cut and padded with 0 to another one.

    Windows are ((column, row) of the first pixel, that of the last).
    """
    width, height = (window[1] - window[0] + 1).tolist()
    whole = np.zeros((height, width, image.shape[-1]), np.float32)
    first, end = np.maximum(stored[0], window[0]), np.minimum(stored[1], window[1]) + 1
    if (end > first).all():
        (left, top), (right, bottom) = (first - window[0]).tolist(), (end - window[0]).tolist()
        column, row = (first - stored[0]).tolist()
        whole[top:bottom, left:right] = image[row : row + bottom - top, column : column + right - left]
    return whole


def expect_radiance(path: Path, radiance: np.ndarray) -> None:
    """Raise InputError for values below zero, except what lossy compression leaves there, and for primaries other than Rec.709's.

    OpenEXR names them in its header, where they are others: ACES, Rec.2020, P3.
    """
    if radiance.min(initial=0) < -RINGING * radiance.max(initial=0):
        raise InputError(f"{path}: expected radiance, found the negative value {radiance.min():g}")
    if path.suffix.lower() == ".exr":
        with OpenEXR.File(str(path), header_only=True) as file:
            primaries = file.header().get("chromaticities", REC709)
        _expect_rec709(path, f"chromaticities {np.round(primaries, 4).tolist()}", primaries)


def _expect_rec709(path: Path, found: str, primaries: Sequence[float] | np.ndarray, *others: Sequence[float]) -> None:
    if min(np.abs(np.subtract(primaries, like)).max() for like in (REC709, *others)) > ALIKE:
        raise InputError(f"{path}: expected linear radiance of Rec.709 (sRGB), found {found}; convert the picture")


def read_light(path: Path) -> np.ndarray:
    """The map (H, 2H, 3) float32 of an OpenEXR or Radiance file; what rounding left below 0 is set to 0. Raises InputError."""
    radiance = read_rgbe(path) if path.suffix.lower() == ".hdr" else read_exr(path, 3)
    height, width = radiance.shape[:2]
    if width != 2 * height:
        raise InputError(f"{path}: expected a lat-long map, twice as wide as high, found {width} x {height}")
    expect_radiance(path, radiance)
    if not radiance.max(initial=0) <= BRIGHTEST:
        raise InputError(f"{path}: expected radiance up to {BRIGHTEST:g}, found {radiance.max():g}")
    return radiance.clip(min=0)


def write_exr(path: Path, image: np.ndarray, *, half: bool = True) -> None:
    """Write (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) values; the file appears whole or not at all.

    ``half`` halves the size and holds values up to 65504; larger ones need ``half=False``, so they raise ValueError,
    as do NaN and Inf, which :func:`read_exr` would refuse. Raises OSError where the file cannot be written.
    """
    pixels = image[..., None] if image.ndim == 2 else image
    names = {1: "Y", 3: "RGB", 4: "RGBA"}[pixels.shape[-1]]
    if not np.isfinite(pixels).all():
        raise ValueError(f"{path}: {int((~np.isfinite(pixels)).sum())} values are NaN or infinite")
    if half and np.abs(pixels).max(initial=0) > np.finfo(np.float16).max:
        raise ValueError(f"{path}: value {np.abs(pixels).max():g} does not fit into half float")
    dtype = np.float16 if half else np.float32
    channels = {name: np.ascontiguousarray(pixels[..., i].astype(dtype)) for i, name in enumerate(names)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial, OpenEXR.File(header, channels) as file:
        try:
            file.write(str(partial))
        except RuntimeError as error:  # what OpenEXR makes of a full disk: a sentence with the path, and one that says why
            why = str(error).rpartition('". ')[2].rstrip(".")
            number = next((one for one in errno.errorcode if os.strerror(one) == why), errno.EIO)
            raise OSError(number, why, str(path)) from error


# ---------------------------------------------------------------- Radiance pictures (.hdr)
# A pixel (r, g, b, e) is (r, g, b) 2^(e - 136), black where e is 0 (Ward, "Real Pixels", Graphics Gems II, 1991; file layout:
# Radiance's reference manual, "filefmts"). Rows run from top to bottom, which is what all programs write.
LARGEST = 255 * 2.0**119  # what a pixel can hold
SHORTEST, LONGEST = 8, 32767  # pixels of a row that may be run-length encoded
SIZE = re.compile(rb"-Y ([1-9]\d{0,8}) \+X ([1-9]\d{0,8})\n")


def read_rgbe(path: Path) -> np.ndarray:
    """The picture (H, W, 3) float32, linear. Raises InputError, naming the file, for one that is none or ends too early."""
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such image")
    content = path.read_bytes()
    head, _, rest = content.partition(b"\n\n")
    size = SIZE.match(rest)
    if not head.startswith(b"#?") or b"32-bit_rle_xyze" in head or size is None:
        expected = "expected a Radiance picture in 32-bit_rle_rgbe, which begins with #? and has a size as '-Y rows +X columns'"
        raise InputError(f"{path}: {expected}, found {shown(repr(content[:40]))}")
    height, width = int(size[1]), int(size[2])
    expect_size_to_read(path, width, height)
    rows, place = np.zeros((height, width, 4), np.uint8), len(head) + 2 + size.end()
    try:
        for row in rows:
            place = _row(content, place, row)
    except (IndexError, ValueError, MemoryError):
        raise InputError(f"{path}: expected {height} rows of {width} pixels, found damaged or missing data") from None
    for primaries in _lines(path, head, "PRIMARIES", 8):
        _expect_rec709(path, f"PRIMARIES= {primaries.round(4).tolist()}", primaries, RADIANCE)
    scale = np.where(rows[..., 3] > 0, np.exp2(rows[..., 3].astype(np.float64) - 136), 0)[..., None]
    for factors in (*_lines(path, head, "EXPOSURE", 1, above=0), *_lines(path, head, "COLORCORR", 3, above=0)):
        with np.errstate(over="ignore"):  # a light that bright is refused
            scale = scale / factors  # by which pixels have been multiplied
    return (rows[..., :3] * scale).clip(max=np.finfo(np.float32).max).astype(np.float32)


def _lines(path: Path, head: bytes, name: str, count: int, *, above: float = -math.inf) -> Iterator[np.ndarray]:
    """The numbers in each of a header's lines NAME=. Raises InputError for a line without ``count`` of them, all ``above``."""
    for line in re.findall(rb"^%s=(.*)" % name.encode(), head, re.MULTILINE):
        with suppress(ValueError):
            found = np.array(line.split(), float)
            if found.shape == (count,) and (found > above).all() and np.isfinite(found).all():
                yield found
                continue
        expected = ("a number" if count == 1 else f"{count} numbers") + (f" above {above:g}" if math.isfinite(above) else "")
        raise InputError(f"{path}: {name}: expected {expected}, found {shown(line.decode(errors='replace').strip())}")


def rgbe(radiance: np.ndarray) -> bytes:
    """The file of a picture (H, W, 3), in plain rows."""
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % radiance.shape[:2] + rgbe_texels(radiance).tobytes()


def rgbe_texels(radiance: np.ndarray) -> np.ndarray:
    """The nearest RGBE value to each pixel (H, W, 3), linear and not negative: (H, W, 4) uint8; LARGEST for what is brighter.

    Raises ValueError for NaN and infinity.
    """
    if not np.isfinite(radiance).all():
        raise ValueError("radiance: expected finite values, found NaN or infinity")
    radiance = radiance.clip(max=LARGEST)
    brightest = radiance.max(-1)
    exponents = np.frexp(brightest)[1]  # brightest = f 2^e with f in [.5, 1)
    exponents += np.rint(np.ldexp(brightest, 8 - exponents)) > 255  # which rounds up to the next power of 2
    texels = np.zeros((*brightest.shape, 4), np.uint8)
    texels[..., :3] = np.rint(np.ldexp(radiance, 8 - exponents[..., None])).clip(0, 255)
    texels[..., 3] = np.where(brightest > 0, exponents + 128, 0).clip(0, 255)
    return texels


def _row(content: bytes, place: int, row: np.ndarray) -> int:
    """Fill one ``row`` (W, 4) from ``place`` on and return where the next one begins."""
    width = len(row)
    if not SHORTEST <= width <= LONGEST or content[place : place + 4] != bytes([2, 2, width >> 8, width & 255]):
        row[:] = np.frombuffer(content, np.uint8, 4 * width, place).reshape(width, 4)
        return place + 4 * width
    place += 4
    for channel in row.T:
        column = 0
        while column < width:
            count = content[place]
            run, length = count > 128, count - 128 if count > 128 else count
            if not length or column + length > width:
                raise ValueError("a run beyond the row")
            channel[column : column + length] = np.frombuffer(content, np.uint8, 1 if run else length, place + 1)
            place += 2 if run else 1 + length
            column += length
    return place
