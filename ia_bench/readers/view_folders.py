"""Folders of one view each, as NeRFactor's renderer writes them and TensoIR-Synthetic keeps them.

SPLIT_NNN/metadata.json holds ``cam_transform_mat`` (16 numbers as one text, camera-to-world, OpenGL axes), ``cam_angle_x`` in
radians, ``imw`` and ``imh``; beside it lie photographs ``rgba_LIGHT.png`` (8-bit sRGB, straight alpha), ``albedo.png`` (8-bit
*linear*) and ``normal.png`` ((n + 1) / 2, world space). The pictures are Blender's: the first pixel's centre is at (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json, shown
from ia_bench.readers.fields import focal_of, number, rigid
from ia_bench.readers.pictures import expect_size, photograph, true_map, true_normal
from ia_bench.scenes.scene import Camera, View


@dataclass(frozen=True)
class ViewFolder:
    """The folder of one view below the dataset's ``root``."""

    root: Path
    folder: Path

    @cached_property
    def metadata(self) -> dict[str, object]:
        """What metadata.json says."""
        return read_json(file_below(self.root, f"{self.folder.name}/metadata.json", str(self.root)))

    @cached_property
    def camera(self) -> Camera:
        """The camera of all pictures of the folder. Raises InputError."""
        where, fields = str(self.folder / "metadata.json"), self.metadata
        for key in ("cam_transform_mat", "cam_angle_x", "imw", "imh"):
            if key not in fields:
                raise InputError(f"{where}: expected {key}, found none")
        width, height = int(number(where, fields, "imw")), int(number(where, fields, "imh"))
        focal = focal_of(where, "cam_angle_x", number(where, fields, "cam_angle_x"), width)
        text = fields["cam_transform_mat"]
        try:
            values = np.array([float(part) for part in str(text).split(",")])
        except ValueError:
            raise InputError(f"{where}: cam_transform_mat: expected 16 numbers with commas, found {shown(repr(text))}") from None
        if values.size != 16:
            raise InputError(f"{where}: cam_transform_mat: expected 16 numbers with commas, found {values.size}")
        to_world = rigid(where, "cam_transform_mat", values.reshape(4, 4))
        return Camera(to_world, (focal, focal), (0.5 * width, 0.5 * height), width, height)

    def picture(self, *names: str) -> Path:
        """The first of some pictures that is there. Raises InputError where none is."""
        there = next((name for name in names if (self.folder / name).is_file()), names[0])
        return file_below(self.root, f"{self.folder.name}/{there}", str(self.root))

    def view(self, path: Path, notes: list[str], light: str = "train") -> View:
        """The photograph ``path`` of this folder. Raises InputError for another size than the camera's."""
        photo = photograph(path, None, notes)
        expect_size(path, photo.mask.shape, (self.camera.height, self.camera.width), "imw and imh of metadata.json")
        name = self.folder.name if light == "train" else f"{self.folder.name}_{light}"
        return photo.view(name, self.camera, light)

    def with_truth(self, view: View) -> View:
        """The view with the albedo and the normals that lie beside it, as far as they do."""
        albedo, normal = self.folder / "albedo.png", self.folder / "normal.png"
        return replace(
            view,
            albedo=true_map(self.picture("albedo.png"), view.mask, "linear") if albedo.is_file() else None,
            normal=true_normal(self.picture("normal.png"), view.mask) if normal.is_file() else None,
        )

    def lights(self) -> dict[str, Path]:
        """Every rgba_LIGHT.png of the folder by the name of its light."""
        return {path.stem.removeprefix("rgba_"): path for path in sorted(self.folder.glob("rgba_*.png"))}


def view_folders(root: Path, split: str) -> list[ViewFolder]:
    """The folders SPLIT_NNN below ``root``, in order."""
    return [ViewFolder(root, path) for path in sorted(root.glob(f"{split}_[0-9]*")) if path.is_dir()]
