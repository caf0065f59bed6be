"""Reader of DTU scans, and of any capture, in the layout of IDR (Yariv et al., NeurIPS 2020): image/, mask/ and cameras.npz.

``world_mat_i`` (4, 4) holds K [R | t] of the i-th photograph by name, with OpenCV's axes and pixels counted from the centre of the
first; ``scale_mat_i`` maps the unit sphere to where the object is. The scene is read in units of that sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below
from ia_bench.readers.base import UnsplitReader
from ia_bench.readers.cameras import from_projection
from ia_bench.readers.contract import FAR
from ia_bench.readers.pictures import masks_of, photograph, pictures_in
from ia_bench.scenes.photograph import read_arrays
from ia_bench.scenes.scene import Scene, View

CAMERAS = "cameras.npz", "cameras_sphere.npz"  # of IDR, and of NeuS, which lays its scans and BlendedMVS out alike


@dataclass(frozen=True, kw_only=True)
class DtuReader(UnsplitReader):
    """Reads the folder of one scan. A ``mesh`` is in the units of world_mat (millimetres in DTU)."""

    format = "dtu"

    def read(self, truth: bool) -> Scene:
        """The scene; the dataset has no truth of material or light. Raises InputError."""
        notes, folder = list[str](), self.folder
        photos = pictures_in(folder / "image")
        masks = masks_of(folder / "mask", photos, notes)
        name = next((name for name in CAMERAS if (folder / name).is_file()), CAMERAS[0])
        matrices = _matrices(file_below(folder, name, str(folder)), len(photos))
        scale = matrices[0][1]

        def view(place: int) -> View:
            path, (world, _) = photos[place], matrices[place]
            photo = photograph(path, masks[place], notes, folder / "mask")
            height, width = photo.mask.shape
            where = f"{folder / name}: world_mat_{place} @ scale_mat_{place}"
            return photo.view(path.stem, from_projection(where, (world @ scale)[:3], width, height))

        notes.append("photographs are decoded as sRGB: the tone curve of DTU's camera is not known")
        return self.unsplit(len(photos), view, notes, place=np.linalg.inv(scale))


def _matrices(path: Path, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """world_mat_i and scale_mat_i of every photograph, ``count`` in all.

    Raises InputError for anything else, and for another number of cameras: photographs belong to cameras by their order, so where
    one is missing, or one too many, all that follow would have a wrong camera.
    """
    stored = read_arrays(path, lambda key: key.split("_mat_")[0] in ("world", "scale"))
    cameras = sum(name.removeprefix("world_mat_").isdecimal() for name in stored)
    if cameras != count:
        raise InputError(f"{path}: expected as many photographs in image/ as cameras ({cameras}), found {count}")
    pairs = []
    for place in range(count):
        names = f"world_mat_{place}", f"scale_mat_{place}"
        for key in names:
            if (shape := stored.get(key, np.zeros(0)).shape) != (4, 4):
                raise InputError(f"{path}: {key}: expected 4 x 4 numbers for each photograph in image/, found shape {shape}")
            if (most := np.abs(stored[key]).max()) > FAR:
                raise InputError(f"{path}: {key}: expected numbers up to {FAR:g}, found {most:g}")
        pairs.append((stored[names[0]], stored[names[1]]))
    scale = pairs[0][1]
    same = all(np.allclose(one, scale) for _, one in pairs)
    if not (same and scale[0, 0] > 0 and np.allclose(scale[:3, :3], scale[0, 0] * np.eye(3), rtol=1e-5, atol=1e-5 * scale[0, 0])):
        raise InputError(f"{path}: scale_mat_i: expected one positive scale and a translation, all alike, found other ones")
    return pairs
