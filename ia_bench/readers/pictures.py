"""Photographs, masks and truth of other people's data as the arrays of a View: linear, premultiplied, of one size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Literal

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.photograph import IGNORED, read_mask, read_photograph, read_values
from ia_bench.scenes.scene import Camera, View

Encoding = Literal["srgb", "linear"]
SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".tiff", ".tif")
"""Of photographs, in lower case; cameras write them in upper case, too."""
CLIPPED = 0.9999  # of a linear channel; 254 of 255 is .991
FLAWLESS = 0.9  # intersection over union of the masks of a photograph and its truth; edges of binary masks differ by less


# ---------------------------------------------------------------- files
def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder, by name; suffixes may be in upper case. Raises InputError for no folder and for an empty one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of photographs, found none")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not found:
        raise InputError(f"{folder}: expected photographs ({', '.join(SUFFIXES)}), found none")
    return found


def picture_below(folder: Path, name: object, where: str) -> Path:
    """The picture below ``folder`` that ``name`` means, with or without its suffix. Raises InputError naming ``where``."""
    if isinstance(name, str) and name and not (folder / name).is_file():
        for suffix in (*SUFFIXES, *map(str.upper, SUFFIXES)):
            if (folder / f"{name}{suffix}").is_file():
                return file_below(folder, f"{name}{suffix}", where)
    return file_below(folder, name, where)


def mask_beside(folder: Path, photo: Path) -> Path:
    """The mask of a photograph: NAME.png, or its whole name and .png, as COLMAP has it. Raises InputError where it is neither."""
    names = (f"{photo.stem}.png", f"{photo.name}.png", photo.name)
    found = next((path for name in names if (path := folder / name).is_file()), None)
    if found is None:
        raise InputError(f"{photo}: expected a mask {folder / names[0]}, found none")
    return found


# ---------------------------------------------------------------- photographs
class Notes(list[str]):
    """What is told of a scene, one line each. ``own_alpha``: whether a photograph was read whose mask is its own alpha."""

    own_alpha = False


@dataclass(frozen=True)
class Photo:
    """The pixels of one photograph, as a View holds them.

    Attributes:
        image: Linear radiance (H, W, 3) float32, premultiplied; 0 beyond the object.
        mask: Coverage (H, W) float32.
        valid: (H, W) bool, False where a channel of 8 bits is at its end; None where none is.
    """

    image: np.ndarray
    mask: np.ndarray
    valid: np.ndarray | None = None

    @classmethod
    def of(cls, image: np.ndarray, mask: np.ndarray, clipped: np.ndarray | np.bool) -> Photo:
        """The photograph of these pixels, of which those that are ``clipped`` (H, W) and show the object are not known."""
        lost = clipped & (mask > 0)
        pixels = np.ascontiguousarray(image, np.float32), np.asarray(mask, np.float32)
        return cls(*pixels, ~lost if lost.any() else None)

    def view(self, name: str, camera: Camera, light: str = "train") -> View:
        """The view that the photograph is of."""
        return View(name, camera, self.image, self.mask, light, valid=self.valid)


def photograph(path: Path, mask: Path | None, notes: Notes, sought: Path | None = None) -> Photo:
    """A photograph, linear as OpenEXR or 8-bit sRGB as anything else, with the pixels as they are stored, whatever its EXIF says.

    ``mask`` is a file of its own, None where the picture's alpha is the mask. Raises InputError where there is neither; it names
    the file that a reader has ``sought`` in vain.
    """
    image, coverage = read_photograph(path, mask, upright=False, notice=lambda note: _note(notes, path, note))
    if mask is None and coverage.min() >= 1:
        lacking = "no mask" if sought is None else f"no {sought}{_lookalike(sought)}"
        raise InputError(f"{path}: expected a mask in its alpha, or in a file of its own, found an opaque picture and {lacking}")
    notes.own_alpha |= mask is None
    image[coverage <= 0] = 0  # what lossy files leave there
    clipped = (image >= CLIPPED * coverage[..., None]).any(-1) & (path.suffix.lower() != ".exr")
    return Photo.of(image, coverage, clipped)


def _note(notes: list[str], path: Path, note: str) -> None:
    """Add a note on the file ``path``, but a colour profile that all photographs share is told of once."""
    said = note.removeprefix(str(path))
    if not (said.endswith(IGNORED) and any(known.endswith(said) for known in notes)):
        notes.append(note)


def _lookalike(sought: Path) -> str:
    """What to say of a file with another suffix in the place of a mask."""
    others = sorted(sought.parent.glob(f"{escape(sought.stem)}.*"))
    return f"; {others[0].name}, which lies there, is no {sought.suffix} file" if others else ""


def tone_mapped(path: Path, mask: Path, decode: Callable[[np.ndarray], np.ndarray]) -> Photo:
    """A photograph in 8 bits of another tone curve than sRGB, with a mask of its own; ``decode`` turns [0, 1] into radiance."""
    stored, coverage = read_values(path), read_mask(mask)
    expect_size(mask, coverage.shape, stored.shape, str(path))
    if not (coverage > 0.5).any():
        raise InputError(f"{mask}: the mask has no pixel of an object (all of it is 0)")
    return Photo.of(decode(stored[..., :3]) * coverage[..., None], coverage, (stored[..., :3] >= 1).any(-1))


# ---------------------------------------------------------------- truth
def fitted(path: Path, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """``values`` (H, W[, C]) at the size ``shape`` by the mean of whole blocks. Raises InputError where that is none."""
    block = values.shape[0] // shape[0] if values.ndim >= 2 else 0
    if values.shape[:2] != (block * shape[0], block * shape[1]):
        found = " x ".join(map(str, values.shape))
        raise InputError(f"{path}: expected {shape[0]} x {shape[1]} values, or a multiple of these, found {found}")
    return values.reshape(shape[0], block, shape[1], block, -1).mean((1, 3)).reshape(*shape[:2], *values.shape[2:])


def expect_size(path: Path, found: tuple[int, ...], expected: tuple[int, ...], like: str) -> None:
    """Raise InputError unless an image of shape ``found`` has the height and width of ``expected``, those of ``like``."""
    if found[:2] != expected[:2]:
        raise InputError(f"{path}: expected {expected[1]} x {expected[0]} pixels like {like}, found {found[1]} x {found[0]}")


def true_map(path: Path, mask: np.ndarray, encoding: Encoding, *, channels: int = 3) -> np.ndarray | None:
    """Albedo or roughness (H, W[, 3]) of a picture, premultiplied by the photograph's ``mask``; None where there is no file.

    Straight values are taken as they are or decoded from sRGB; a picture's own alpha must cover what the photograph's does.
    Raises InputError for another size and another silhouette.
    """
    if not path.is_file():
        return None
    stored = read_values(path)
    values, alpha = stored[..., :channels], stored[..., 3]
    if encoding == "srgb":
        values = srgb_to_linear(values)
    expect_size(path, values.shape, mask.shape, "its photograph")
    if alpha.min() < 1:
        both, either = np.minimum(alpha, mask).sum(), np.maximum(alpha, mask).sum()
        if both < FLAWLESS * either:
            found = f"an intersection over union of {both / either:.2f}"
            raise InputError(f"{path}: expected truth with the silhouette of its photograph, found {found}: is it of another view?")
        values = np.where(alpha[..., None] > 0, values, 0)
    truth = (values * mask[..., None]).astype(np.float32)
    return truth if channels == 3 else truth[..., 0]


def true_normal(path: Path, mask: np.ndarray) -> np.ndarray | None:
    """World-space normals (H, W, 3) that a picture stores as (n + 1) / 2, premultiplied by ``mask``; None where there is none."""
    if not path.is_file():
        return None
    stored = read_values(path)
    expect_size(path, stored.shape, mask.shape, "its photograph")
    normal = 2 * stored[..., :3] - 1
    length = np.linalg.norm(normal, axis=-1)
    solid = (mask > 0.99) & (stored[..., 3] > 0.99)
    if solid.any() and np.median(np.abs(length[solid] - 1)) > 0.1:
        found = f"a median length of {np.median(length[solid]):.2f}"
        raise InputError(f"{path}: expected unit normals stored as (n + 1) / 2, found {found}")
    normal = normal / np.maximum(length, 1)[..., None]
    return (normal * mask[..., None]).astype(np.float32)
