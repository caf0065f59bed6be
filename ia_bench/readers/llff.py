"""Reader of LLFF's folders (Mildenhall et al., SIGGRAPH 2019), in which NeRD's real captures lie, too: poses_bounds.npy, images/.

The i-th row of 17 numbers belongs to the i-th photograph by name: a matrix (3, 5) whose columns are the camera's axes down, right
and backwards, its place, and (height, width, focal length) of the photographs that were calibrated; then the nearest and the
farthest depth. Principal points are the middle. A mask is masks/NAME.png or the picture's alpha.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.readers.base import UnsplitReader
from ia_bench.readers.cameras import rigid
from ia_bench.readers.contract import check_camera
from ia_bench.readers.pictures import masks_of, photograph, pictures_in
from ia_bench.scenes.photograph import read_array
from ia_bench.scenes.scene import Camera, Scene, View

POSES = "poses_bounds.npy"
ASPECT = 0.01  # by which photographs that were made smaller may miss the aspect of those that were calibrated


@dataclass(frozen=True, kw_only=True)
class LlffReader(UnsplitReader):
    """Reads the folder of one capture.

    Attributes:
        images: The folder of the photographs, such as images_4 for smaller ones.
        masks: The folder of their masks; where there is none, alpha is the mask.
    """

    format = "llff"
    images: str = "images"
    masks: str = "masks"

    def read(self, truth: bool) -> Scene:
        """The scene; the format holds no truth. Raises InputError."""
        notes, folder = list[str](), self.folder
        photos, rows = pictures_in(folder / self.images), read_array(folder / POSES)
        if rows.shape != (len(photos), 17):
            said = f"expected {len(photos)} x 17 numbers, a row a photograph in {self.images}, found shape {rows.shape}"
            raise InputError(f"{folder / POSES}: {said}")
        masks = masks_of(folder / self.masks, photos, notes)

        def view(place: int) -> View:
            photo = photograph(photos[place], masks[place], notes, folder / self.masks)
            name = photos[place].stem
            return photo.view(name, self._camera(f"{folder / POSES}: row {place}", photos[place], rows[place], photo.mask.shape))

        return self.unsplit(len(photos), view, notes)

    def _camera(self, where: str, path: Path, row: np.ndarray, shape: tuple[int, ...]) -> Camera:
        (down, right, back, place, size), (height, width) = row[:15].reshape(3, 5).T, shape
        rows, columns, focal = size.tolist()
        if min(rows, columns, focal) <= 0:
            raise InputError(f"{where}: expected height, width and focal length above 0, found {size.tolist()}")
        scale = width / columns
        if abs(height / (scale * rows) - 1) > max(ASPECT, 1 / height):
            raise InputError(
                f"{path}: expected the aspect of {columns:g} x {rows:g} pixels, as {where} says, found {width} x {height}"
            )
        matrix = np.vstack([np.stack([right, -down, back, place], -1), [0, 0, 0, 1]])
        to_world = rigid(where, "pose", matrix)
        return check_camera(where, Camera(to_world, (scale * focal,) * 2, (width / 2, height / 2), width, height))
