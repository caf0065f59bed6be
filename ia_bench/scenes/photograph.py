"""Reading any picture as a linear image with a mask: photographs with EXIF orientation, alpha and colour profiles, OpenEXR.

Whatever is read, its size is asked for before its pixels, here and for arrays of numpy.
"""

from __future__ import annotations

import struct
import tokenize
import warnings
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from PIL import ExifTags, Image, ImageCms, ImageOps

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import log
from ia_bench.common.files import is_file, shown
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import MAX_PIXELS, expect_radiance, expect_size_to_read, read_exr

HIGH_BIT_MODES = {"I;16": 65535.0, "I;16B": 65535.0, "I;16L": 65535.0, "I": 65535.0}
"""Greyscale modes of Pillow with more than 8 bits, and the value of white in them."""

CONVERTED = ("RGB", "RGBA", "P")
"""Modes of Pillow whose colours a profile is applied to: 8 bits of red, green and blue."""
VIVID = 64  # steps of 255 between the channels of a pixel, more than compression leaves of a grey
PROFILE_ROUNDING = 2  # steps of 255 by which a profile of sRGB itself may move a colour
IGNORED = "is ignored, and sRGB assumed"
REDUCED = "its 16 bits a channel are read as 8; OpenEXR keeps them"

BROKEN_ARRAYS = (
    OSError, ValueError, TypeError, EOFError, SyntaxError, MemoryError, OverflowError, RuntimeError, BadZipFile, zlib.error,
    tokenize.TokenError,
)  # fmt: skip
"""What numpy raises for damaged files, and for those of another kind."""
ALPHA_ROUNDING = 1e-3  # half floats and filters pass 0 and 1 by a little


def read_photograph(
    path: Path, mask: Path | None = None, *, upright: bool = True, notice: Callable[[str], None] = log.warning
) -> tuple[np.ndarray, np.ndarray]:
    """A picture as linear radiance (H, W, 3) float32, premultiplied, and its mask (H, W) in [0, 1].

    OpenEXR files are linear and their alpha premultiplied; everything else that Pillow opens is sRGB with straight alpha, or is
    made sRGB by the colour profile in it. ``mask``: a picture of the same size, white where the object is; it multiplies the
    alpha. Without either the whole picture is the object. ``notice`` is told what had to be mended.

    ``upright`` turns photograph and mask by the EXIF orientation of each, as viewers do. A photograph with a camera needs False,
    since calibrated cameras, and masks made for them, are of the pixels as they are stored. Raises InputError.
    """
    if path.suffix.lower() == ".exr":
        radiance, coverage = _read_linear(path, notice)
    else:
        values = picture_values(path, in_srgb(path, open_picture(path, upright=upright, notice=notice), notice))
        radiance, coverage = srgb_to_linear(values[..., :3]) * values[..., 3:], values[..., 3]
    if mask is not None:
        chosen = read_mask(mask, upright=upright)
        expect_size(mask, chosen.shape, coverage.shape, str(path))
        radiance, coverage = radiance * chosen[..., None], coverage * chosen
    if not (coverage > 0).any():
        raise InputError(f"{mask or path}: the mask has no pixel of an object (all of it is 0)")
    return radiance.astype(np.float32), coverage.astype(np.float32)


def expect_size(path: Path, found: tuple[int, ...], expected: tuple[int, ...], like: str) -> None:
    """Raise InputError unless an image of shape ``found`` has the height and width of ``expected``, those of ``like``."""
    if found[:2] != expected[:2]:
        raise InputError(f"{path}: expected {expected[1]} x {expected[0]} pixels like {like}, found {found[1]} x {found[0]}")


def _read_linear(path: Path, notice: Callable[[str], None]) -> tuple[np.ndarray, np.ndarray]:
    image = read_exr(path, None)
    expect_radiance(path, image[..., :3])
    below = int((image[..., :3] < 0).any(-1).sum())
    if below:
        notice(f"{path}: {below} pixels are below zero, as lossy compression leaves them, and set to 0")
        image[..., :3] = image[..., :3].clip(min=0)
    if image.shape[-1] == 3:
        return image, np.ones(image.shape[:2], np.float32)
    return image[..., :3], unit_alpha(path, image[..., 3])


def unit_alpha(path: Path, alpha: np.ndarray) -> np.ndarray:
    """An alpha (H, W), less what rounding left beyond 0 to 1. Raises InputError for more than that."""
    wrong = (alpha < -ALPHA_ROUNDING) | (alpha > 1 + ALPHA_ROUNDING)
    if wrong.any():
        raise InputError(f"{path}: expected alpha from 0 to 1, found {alpha[wrong][0]:g} in {int(wrong.sum())} pixel(s)")
    return alpha.clip(0, 1)


def read_values(path: Path) -> np.ndarray:
    """A picture as it is stored, (H, W, 4) float32 from 0 to 1, opaque where it has no alpha. Raises InputError."""
    return picture_values(path, open_picture(path))


def read_stored(path: Path, *, grey: bool = False) -> np.ndarray:
    """Values as they are stored, (H, W, 3) float32, or 4 with alpha: of OpenEXR, of .npy, or from 0 to 1 of what Pillow reads.

    ``grey``: one channel will do. Raises InputError, naming the file.
    """
    if path.suffix.lower() == ".npy":
        values = read_array(path)
    elif path.suffix.lower() == ".exr":
        values = read_exr(path, None, grey=grey)
    else:
        picture = open_picture(path)
        if not grey and picture.mode != "P" and len(picture.getbands()) < 3:
            raise InputError(f"{path}: expected red, green and blue, found a picture in grey ({picture.mode})")
        opaque = "A" not in picture.getbands() and "transparency" not in picture.info
        values = picture_values(path, picture)[..., : 3 if opaque else 4]
    if values.ndim != 3 or values.shape[-1] not in (3, 4, int(grey)) or not values.size:
        raise InputError(f"{path}: expected (height, width, 3) values, or 4 with alpha, found shape {values.shape}")
    if abs(values).max() > np.finfo(np.float32).max:
        raise InputError(f"{path}: expected values that float32 can hold, found {abs(values).max():g}")
    return np.ascontiguousarray(values, np.float32)


def picture_values(path: Path, picture: Image.Image) -> np.ndarray:
    """A picture of Pillow as :func:`read_values` has it; ``path`` names it in messages."""
    if picture.mode in HIGH_BIT_MODES:
        grey = greyscale(path, picture)
        return np.dstack([grey, grey, grey, np.ones_like(grey)])
    return np.asarray(picture.convert("RGBA"), np.float32) / 255


def read_mask(path: Path, *, upright: bool = False) -> np.ndarray:
    """A mask (H, W) from 0 to 1: the alpha of a cut-out, or else how bright the picture is.

    ``upright`` turns it by its EXIF orientation. Raises InputError, also for a map of labels, which is 1 or a colour where the
    object is and not white; a mask that is 0 everywhere is for the caller to refuse.
    """
    picture = open_picture(path, upright=upright)
    if "transparency" in picture.info:
        picture = picture.convert("RGBA")
    if "A" in picture.getbands():
        alpha = np.asarray(picture.getchannel("A"), np.float32) / 255
        if alpha.min() < 1:
            return alpha  # a cut-out: its shape is in its alpha
    if picture.mode in CONVERTED:
        colours = np.asarray(picture.convert("RGB"), np.int16).reshape(-1, 3)
        vivid = np.ptp(colours, axis=1)
        if vivid.max() > VIVID:
            raise InputError(
                f"{path}: expected white (255) where the object is, found the colour {colours[vivid.argmax()].tolist()}"
            )
    mask = greyscale(path, picture)
    if 0 < mask.max() <= 0.5:
        white = HIGH_BIT_MODES.get(picture.mode, 255)
        found = f"values up to {mask.max() * white:.0f} of {white:.0f}"
        raise InputError(f"{path}: expected white ({white:.0f}) where the object is, found {found}")
    return mask


def greyscale(path: Path, picture: Image.Image) -> np.ndarray:
    """A picture of :func:`open_picture` in grey, (H, W) from 0 to 1, whatever its bits. Raises InputError, naming the file."""
    if picture.mode in HIGH_BIT_MODES:  # which convert("L") would cut at 255
        white, values = HIGH_BIT_MODES[picture.mode], np.asarray(picture)
        if values.min() < 0 or values.max() > white:
            raise InputError(f"{path}: expected values from 0 to {white:g}, found {values.min()} to {values.max()}")
        return values.astype(np.float32) / np.float32(white)
    return np.asarray(picture.convert("L"), np.float32) / 255


def open_picture(path: Path, *, upright: bool = False, notice: Callable[[str], None] = log.warning) -> Image.Image:
    """A picture that Pillow reads, whole: as it is stored, or turned ``upright`` by its EXIF orientation.

    ``notice`` is told where bits are lost. Raises InputError, naming the file, for what is none.
    """
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such image")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # of a size that is refused in a sentence of ours
            opened = Image.open(path)
        with opened as file:
            expect_size_to_read(path, *file.size)
            if file.format == "TIFF" and not upright:  # which, of all formats, Pillow turns while it loads it
                file.getexif().pop(ExifTags.Base.Orientation, None)
            file.filename = ""  # by a name Pillow maps plain TIFFs into memory as if they lay there turned, which scrambles them
            reduced = file.mode not in HIGH_BIT_MODES and ";16" in str(file.tile)
            picture = _upright(file) if upright else file.copy()
    except InputError:  # of the size
        raise
    except (OSError, SyntaxError, ValueError, RuntimeError, struct.error, Image.DecompressionBombError) as error:  # of its formats
        raise InputError(f"{path}: expected a picture (PNG, JPEG, TIFF, WebP, ...), found {error}") from None
    if reduced:
        notice(f"{path}: {REDUCED}")
    if picture.mode == "F":
        raise InputError(f"{path}: expected whole numbers, found floating point; linear images are read as OpenEXR")
    if picture.mode == "LAB":
        raise InputError(f"{path}: expected red, green and blue, or grey, found the colours of CIE Lab; save it as sRGB")
    return picture


def _upright(file: Image.Image) -> Image.Image:
    """The picture turned as its EXIF asks for, or as it is where that is damaged."""
    try:
        return ImageOps.exif_transpose(file)
    except (SyntaxError, struct.error):
        return file.copy()


# ---------------------------------------------------------------- colour profiles (ICC)
def in_srgb(path: Path, picture: Image.Image, notice: Callable[[str], None]) -> Image.Image:
    """The ``picture`` with the colours that its profile describes, in sRGB, and its alpha; what sRGB cannot hold is clipped.

    A picture without a profile, or with one of sRGB, is returned as it is. So is one with a profile that cannot be applied (of
    a grey picture or one of CMYK, or damaged), or that is named alone, as cameras do of Adobe RGB, of which ``notice`` is told.
    """
    content = picture.info.get("icc_profile")
    if not content:
        with suppress(SyntaxError, struct.error, ValueError, TypeError, KeyError):  # of a damaged record
            if picture.getexif().get_ifd(ExifTags.IFD.Interop).get(ExifTags.Interop.InteropIndex) == "R03":  # in place of a profile
                notice(f"{path}: its colour space Adobe RGB {IGNORED}")
        return picture
    name, transform = "(damaged)", None
    with suppress(OSError, ValueError, ImageCms.PyCMSError):  # of a profile that is damaged, or not one of red, green and blue
        profile = ImageCms.ImageCmsProfile(BytesIO(content))
        name = shown(ImageCms.getProfileDescription(profile).strip())
        srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
        transform = ImageCms.ImageCmsTransform(profile, srgb, "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
    if transform is not None:  # whether colours change; names of profiles do not tell, as there is a "linear sRGB", too
        levels = np.linspace(0, 255, 6).astype(np.uint8)
        probe = np.stack(np.meshgrid(levels, levels, levels), -1).reshape(6, 36, 3)
        moved = np.asarray(transform.apply(Image.fromarray(probe))).astype(int) - probe.astype(int)
        if np.abs(moved).max() <= PROFILE_ROUNDING:
            return picture
    if transform is None or picture.mode not in CONVERTED:
        notice(f"{path}: its colour profile {name} {IGNORED}")
        return picture
    straight = picture.convert("RGBA")
    turned = transform.apply(straight.convert("RGB"))
    turned.putalpha(straight.getchannel("A"))
    return turned


# ---------------------------------------------------------------- arrays of numpy
def read_array(path: Path) -> np.ndarray:
    """The numbers of a .npy file, float64. Raises InputError for another file, other types than real numbers, NaN and infinity."""
    return _arrays(path, lambda: {"": np.load(path, mmap_mode="r", allow_pickle=False)})[""]


def read_arrays(path: Path, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """The arrays of a .npz file whose names are ``wanted``, as :func:`read_array` has them."""

    def stored() -> dict[str, np.ndarray]:
        with np.load(path, allow_pickle=False) as content:
            if (most := max((info.file_size for info in content.zip.infolist()), default=0)) > 32 * MAX_PIXELS:
                raise InputError(f"{path}: expected arrays of at most {4 * MAX_PIXELS} numbers, found one of {most} bytes")
            return {key: content[key] for key in content.files if wanted(key)}

    return _arrays(path, stored)


def _arrays(path: Path, load: Callable[[], Mapping[str, Any]]) -> dict[str, np.ndarray]:
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such file")
    try:
        stored = load()
    except InputError:
        raise
    except BROKEN_ARRAYS:
        raise InputError(f"{path}: expected arrays of numbers (.npy, .npz), found a damaged file or another one") from None
    doubles = dict[str, np.ndarray]()
    for key, values in stored.items():
        where = f"{path}: {key}" if key else f"{path}"
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "biuf" or values.size > 4 * MAX_PIXELS:
            found = f"{values.size} of {values.dtype}" if isinstance(values, np.ndarray) else type(values).__name__
            raise InputError(f"{where}: expected at most {4 * MAX_PIXELS} real numbers, found {shown(found)}")
        with np.errstate(over="ignore"):  # of numbers with more digits
            doubles[key] = np.asarray(values, np.float64)
        if not np.isfinite(doubles[key]).all():
            raise InputError(f"{where}: expected finite numbers, found NaN or infinity")
    return doubles
