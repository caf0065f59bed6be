"""Photographs, masks, truth and lights of other people's data as the arrays of a Scene: linear, premultiplied, in our layout.

Blender's world texture, and with it every renderer of NeRFactor, TensoIR-Synthetic and Synthetic4Relight, lays a map out as
we do (:mod:`ia_bench.light.latlong`): row 0 is +z (up), the middle column is +x, and the azimuth falls from left to right.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import ExifTags, Image

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, is_file, user_path
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import read_light
from ia_bench.scenes.photograph import IGNORED, REDUCED, expect_size, read_mask, read_photograph, read_values
from ia_bench.scenes.scene import Camera, Truth, View

Encoding = Literal["srgb", "linear"]
SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".tiff", ".tif")
"""The suffixes of photographs, in lower case; cameras write them in upper case, too."""
CLIPPED = 0.9999  # of a linear channel; 254 of 255 is .991


# ---------------------------------------------------------------- files
def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder, by name, in which order they belong to cameras; suffixes may be in upper case.

    Raises InputError for no folder, for an empty one, and for numbers without leading zeros: of 10.png and 2.png the formats' own
    code takes 10 first, and whoever numbered the cameras may have taken 2.
    """
    there = folder.iterdir() if folder.is_dir() else []
    found = sorted(path for path in there if path.suffix.lower() in SUFFIXES and path.name[0] != ".")  # not what macOS hides
    if not found:
        raise InputError(f"{folder}: expected a folder of photographs ({', '.join(SUFFIXES)}), found none")
    before: dict[str, tuple[list[int], Path]] = {}  # of the names that differ in their numbers alone the last one
    for path in found:
        words, numbers = re.sub(r"[0-9]+", "0", path.stem), [int(digits) for digits in re.findall(r"[0-9]+", path.stem)]
        if words in before and before[words][0] > numbers:
            names = f"{before[words][1].name} before {path.name}"
            raise InputError(
                f"{folder}: expected names in the order of their numbers, as pictures belong to cameras by order, found {names}; "
                "rename them with leading zeros, in the order of the cameras"
            )
        before[words] = numbers, path
    return found


def picture_below(folder: Path, name: object, where: str) -> Path:
    """The picture below ``folder`` that ``name`` means, with or without its suffix. Raises InputError naming ``where``."""
    if isinstance(name, str) and name and not is_file(folder / name):
        for suffix in (*SUFFIXES, *map(str.upper, SUFFIXES)):
            if is_file(folder / f"{name}{suffix}"):
                return file_below(folder, f"{name}{suffix}", where)
    return file_below(folder, name, where)


def mask_beside(folder: Path, photo: Path) -> Path:
    """The mask of a photograph as :func:`mask_named` finds it. Raises InputError where there is none."""
    found = mask_named(folder, photo)
    if found is None:
        raise InputError(f"{photo}: expected a mask {folder / photo.stem}.png, found none")
    return found


def masks_of(folder: Path, photos: Sequence[Path], notes: list[str]) -> list[Path | None]:
    """The masks of photographs: :func:`mask_beside`, or in their order, where none has its photograph's name and there are as many.

    So it is in IDR's DTU scans (image/000000.png, mask/000.png); ``notes`` are told. Without the folder, alpha is the mask.
    """
    if not folder.is_dir():
        return [None] * len(photos)
    if not any(mask_named(folder, photo) for photo in photos) and len(masks := pictures_in(folder)) == len(photos):
        notes.append(f"masks belong to photographs by their order: {masks[0].name} is that of {photos[0].name}")
        return [*masks]
    masks = [mask_beside(folder, photo) for photo in photos]
    if len(set(masks)) < len(masks):
        twice = next(mask for mask in masks if masks.count(mask) > 1)
        raise InputError(f"{twice}: expected the mask of one photograph, found it for {masks.count(twice)} of one name")
    return [*masks]


def mask_named(folder: Path, photo: Path) -> Path | None:
    """The mask of a photograph: NAME.png, its whole name and .png, as COLMAP has it, or its own name; None where there is none.

    The suffix may be in upper case.
    """
    names = f"{photo.stem}.png", f"{photo.name}.png", photo.name, f"{photo.stem}.PNG", f"{photo.name}.PNG"
    return next((path for name in names if is_file(path := folder / name)), None)


# ---------------------------------------------------------------- photographs
@dataclass(frozen=True)
class Photo:
    """The pixels of one photograph, as a View holds them: linear and premultiplied, 0 beyond the object; see there."""

    image: np.ndarray
    mask: np.ndarray
    valid: np.ndarray | None = None
    exposure: float | None = None

    @classmethod
    def of(cls, image: np.ndarray, mask: np.ndarray, clipped: np.ndarray | np.bool) -> Photo:
        """The photograph of these pixels, of which those that are ``clipped`` (H, W) and show the object are not known."""
        lost = clipped & (mask > 0)
        pixels = np.ascontiguousarray(image, np.float32), np.asarray(mask, np.float32)
        return cls(*pixels, ~lost if lost.any() else None)

    def view(self, name: str, camera: Camera, light: str = "train") -> View:
        """The view that the photograph is of."""
        return View(name, camera, self.image, self.mask, light, valid=self.valid, exposure=self.exposure)


def photograph(path: Path, mask: Path | None, notes: list[str], masks: Path | None = None) -> Photo:
    """A photograph, linear as OpenEXR or 8-bit sRGB as anything else, with the pixels as they are stored, whatever its EXIF says.

    ``mask`` is a file of its own, None where the picture's alpha is the mask. Raises InputError where there is neither, naming the
    folder ``masks`` in which the file would be found, if there is such a one, and for a file of another suffix than SUFFIXES, which
    would be no part of what a run is known by.
    """
    for file in filter(None, (path, mask)):
        if file.suffix.lower() not in SUFFIXES:
            found = file.suffix or "no suffix"
            raise InputError(f"{file}: expected a photograph or mask with one of the suffixes {', '.join(SUFFIXES)}, found {found}")

    def notice(note: str) -> None:  # what all photographs share is one note
        notes.append(note.removeprefix(f"{path}: its ") if note.endswith((IGNORED, REDUCED)) else note)

    image, coverage = read_photograph(path, mask, upright=False, notice=notice)
    if mask is None and coverage.min() >= 1:
        beside = "" if masks is None else f" such as {masks / path.stem}.png"
        raise InputError(
            f"{path}: expected a mask in its alpha, or in a file of its own{beside}, found an opaque picture and no mask"
        )
    image[coverage <= 0] = 0  # what lossy files leave there
    clipped = (image >= CLIPPED * coverage[..., None]).any(-1) & (path.suffix.lower() != ".exr")
    return replace(Photo.of(image, coverage, clipped), exposure=recorded_exposure(path))


def recorded_exposure(path: Path) -> float | None:
    """Seconds x ISO speed / F-number squared, by which a photograph multiplies radiance; None where its EXIF lacks one of them."""
    if path.suffix.lower() == ".exr":
        return None
    keys = ExifTags.Base.ExposureTime, ExifTags.Base.ISOSpeedRatings, ExifTags.Base.FNumber
    try:
        with Image.open(path) as picture:
            record = picture.getexif().get_ifd(ExifTags.IFD.Exif)
        time, speed, stop = (float(np.ravel(record[key])[0]) for key in keys)
        exposure = time * speed / stop**2
    except (KeyError, IndexError, TypeError, ValueError, ArithmeticError, SyntaxError, struct.error):  # of damaged ones, too
        return None
    return exposure if all(0 < value < float("inf") for value in (time, speed, stop, exposure)) else None


def tone_mapped(path: Path, mask: Path, decode: Callable[[np.ndarray], np.ndarray]) -> Photo:
    """A photograph in 8 bits of another tone curve than sRGB, with a mask of its own; ``decode`` turns [0, 1] into radiance."""
    stored, coverage = read_values(path), read_mask(mask)
    expect_size(mask, coverage.shape, stored.shape, str(path))
    if not (coverage > 0.5).any():
        raise InputError(f"{mask}: the mask has no pixel of an object (all of it is 0)")
    return Photo.of(decode(stored[..., :3]) * coverage[..., None], coverage, (stored[..., :3] >= 1).any(-1))


# ---------------------------------------------------------------- truth
def true_map(path: Path, mask: np.ndarray, encoding: Encoding, *, channels: int = 3) -> np.ndarray | None:
    """Albedo or roughness (H, W[, 3]) of a picture, premultiplied by the photograph's ``mask``; None where there is no file.

    Straight values are taken as they are or decoded from sRGB. Raises InputError for another size.
    """
    if not path.is_file():
        return None
    stored = read_values(path)
    values = srgb_to_linear(stored[..., :channels]) if encoding == "srgb" else stored[..., :channels]
    expect_size(path, values.shape, mask.shape, "its photograph")
    truth = (np.where(stored[..., 3:] > 0, values, 0) * mask[..., None]).astype(np.float32)
    return truth if channels == 3 else truth[..., 0]


def true_normal(path: Path, mask: np.ndarray) -> np.ndarray | None:
    """World-space normals (H, W, 3) that a picture stores as (n + 1) / 2, premultiplied by ``mask``; None where there is none."""
    if not path.is_file():
        return None
    stored = read_values(path)
    expect_size(path, stored.shape, mask.shape, "its photograph")
    return masked_normal(2 * stored[..., :3] - 1, mask)


def masked_normal(normal: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Normals (H, W, 3), those that are too long made unit vectors, premultiplied by ``mask``."""
    unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1)
    return (unit * mask[..., None]).astype(np.float32)


# ---------------------------------------------------------------- lights
def maps_below(folder: str | None, novel: Sequence[View], notes: list[str], own: str, strength: float = 1.0) -> Truth:
    """The maps of all lights that ``reader.options.lights`` holds as NAME.exr or NAME.hdr; ``notes`` are told of the rest.

    Those are the training light, called ``own`` ("" for none) and multiplied by ``strength``, and the lights of ``novel`` views,
    one of which may be called as it is.

    Raises InputError for a folder that is not there, or that holds none of them.
    """
    others = {view.light for view in novel} - {"train"}
    wanted = [*([own] if own else []), *sorted(others - {own})]
    if folder is None:
        notes += ["no environment maps: reader.options.lights names no folder, so nothing can be relit"] if wanted else []
        return Truth({})
    place = user_path("reader.options.lights", folder, folder=True)
    files = {name: path for name in wanted for suffix in (".exr", ".hdr") if (path := place / f"{name}{suffix}").is_file()}
    missing = ", ".join(name for name in wanted if name not in files)
    if missing and not files:
        raise InputError(f"{place}: expected environment maps {missing} (.exr or .hdr), found none of them")
    notes += [f"no environment map of {missing} in {place}"] if missing else []
    maps = {name: read_light(path) for name, path in files.items()}
    lights = {}
    if own in maps:
        with np.errstate(over="ignore"):  # which the check of a scene's lights refuses
            lights["train"] = (strength * maps[own]).astype(np.float32)
    return Truth(lights | {name: radiance for name, radiance in maps.items() if name in others})
