"""Folders of one view each, as NeRFactor's renderer writes them and TensoIR-Synthetic keeps them.

SPLIT_NNN/metadata.json holds ``cam_transform_mat`` (16 numbers as one text, camera-to-world, OpenGL axes), ``cam_angle_x`` in
radians, ``imw`` and ``imh``; beside it lie photographs ``rgba_LIGHT.png`` (8-bit sRGB, straight alpha), ``albedo.png`` (8-bit
*linear*) and ``normal.png`` ((n + 1) / 2, world space). The pictures are Blender's: the first pixel's centre is at (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json, shown
from ia_bench.readers.base import FolderReader
from ia_bench.readers.fields import focal_of, number, rigid
from ia_bench.readers.lights import maps_below
from ia_bench.readers.pictures import Notes, expect_size, photograph, true_map, true_normal
from ia_bench.scenes.scene import Camera, Scene, View


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

    def view(self, path: Path, notes: Notes, light: str = "train") -> View:
        """The photograph ``path`` of this folder. Raises InputError for another size than the camera's."""
        photo = photograph(path, None, notes)
        expect_size(path, photo.mask.shape, (self.camera.height, self.camera.width), "imw and imh of metadata.json")
        name = self.folder.name if light == "train" else f"{self.folder.name}_{light}"
        return photo.view(name, self.camera, light)

    def with_truth(self, view: View) -> View:
        """The view with the albedo and the normals that lie beside it, as far as they do."""
        albedo = true_map(self.folder / "albedo.png", view.mask, "linear")
        return replace(view, albedo=albedo, normal=true_normal(self.folder / "normal.png", view.mask))

    def lights(self) -> dict[str, Path]:
        """Every rgba_LIGHT.png of the folder by the name of its light."""
        return {path.stem.removeprefix("rgba_"): path for path in sorted(self.folder.glob("rgba_*.png"))}


@dataclass(frozen=True, kw_only=True)
class ViewFolders(FolderReader):
    """Reads the folder of one object whose views have folders of their own.

    Attributes:
        lights: The folder of the environment maps, LIGHT.hdr or LIGHT.exr; None relights nothing.
    """

    held_out_splits: ClassVar[Sequence[str]] = ("test",)
    lights: str | None = None

    @property
    def photographs(self) -> Sequence[str]:
        """What the photograph of a view under the training light may be called."""
        raise NotImplementedError

    def novel_lights(self, folder: ViewFolder) -> Mapping[str, Path]:
        """The photographs of a held-out view under other lights, by their names."""
        raise NotImplementedError

    def own_light(self, folder: ViewFolder) -> tuple[str, float]:
        """The name of the training light's map and what it is multiplied by; ``folder`` is that of the first training view."""
        raise NotImplementedError

    def read(self, truth: bool) -> Scene:
        """The scene; albedo and normals of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        notes, training = Notes(), self._folders("train")
        if not training:
            raise InputError(f"{self.folder}: expected folders train_000, train_001, ... with metadata.json, found none")
        train = [self.view(folder.view(folder.picture(*self.photographs), notes)) for folder in training]
        test, novel = list[View](), list[View]()
        held_out = [folder for split in self.held_out_splits for folder in self._folders(split)]
        lit = [one for one in held_out if any((one.folder / name).is_file() for name in self.photographs)]
        for folder in self.kept(lit):
            view = folder.view(folder.picture(*self.photographs), notes)
            test.append(self.view(folder.with_truth(view) if truth else view))
            novel.append(self.view(view))
            novel += [self.view(folder.view(path, notes, light)) for light, path in self.novel_lights(folder).items()]
        if len(lit) < len(held_out):
            without = f"{len(held_out) - len(lit)} of {len(held_out)} held-out views have no photograph"
            notes.append(f"{without} {self.photographs[0]} and are left out")
        known = maps_below(self.lights, novel, notes, *self.own_light(training[0])) if truth else None
        return self.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _folders(self, split: str) -> list[ViewFolder]:
        return [ViewFolder(self.folder, path) for path in sorted(self.folder.glob(f"{split}_[0-9]*")) if path.is_dir()]
