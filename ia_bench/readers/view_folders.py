"""Readers of folders of one view each: NeRFactor's synthetic scenes and TensoIR-Synthetic.

SPLIT_NNN/metadata.json holds ``cam_transform_mat`` (16 numbers as one text, camera-to-world, OpenGL axes), ``cam_angle_x`` in
radians, ``imw`` and ``imh``; beside it lie photographs ``rgba_LIGHT.png`` (8-bit sRGB, straight alpha), ``albedo.png`` (8-bit
*linear*) and ``normal.png`` ((n + 1) / 2, world space). The pictures are Blender's: the first pixel's centre is at (0.5, 0.5).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json, shown
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import focal_of, number, positive, rigid, text
from ia_bench.readers.contract import check_camera
from ia_bench.readers.pictures import maps_below, photograph, true_map, true_normal
from ia_bench.scenes.exr import BRIGHTEST
from ia_bench.scenes.photograph import expect_size
from ia_bench.scenes.scene import Camera, Scene, View

TURNED = re.compile(r"_\d{3}$")  # the name of a light that TensoIR has turned by so many degrees


@dataclass(frozen=True, kw_only=True)
class ViewFolders(FolderReader):
    """Reads the folder of one object whose views have folders of their own.

    Attributes:
        lights: The folder of the environment maps, LIGHT.hdr or LIGHT.exr; None relights nothing.
    """

    held_out_splits: ClassVar[tuple[str, ...]] = ("test",)
    lights: str | None = None

    @property
    def photographs(self) -> tuple[str, ...]:
        """What the photograph of a view under the training light may be called."""
        raise NotImplementedError

    def is_novel(self, light: str) -> bool:
        """Whether photographs under this light are those of another environment map."""
        raise NotImplementedError

    def own_light(self, where: str, metadata: dict[str, Any]) -> tuple[str, float]:
        """The name of the training light's map and what it is multiplied by, from the metadata of the first training view."""
        raise NotImplementedError

    def read(self, truth: bool) -> Scene:
        """The scene; albedo and normals of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        notes, training = list[str](), list(self._folders("train"))
        if not training:
            raise InputError(f"{self.folder}: expected folders train_000, train_001, ... with metadata.json, found none")
        train = [self.view(self._view(folder, self._photo(folder), notes)) for folder in training]
        test, novel = list[View](), list[View]()
        held_out = [folder for split in self.held_out_splits for folder in self._folders(split)]
        lit = [folder for folder in held_out if self._photo(folder).is_file()]
        if len(lit) < len(held_out):
            without = f"{len(held_out) - len(lit)} of {len(held_out)} held-out views have no photograph"
            notes.append(f"{without} {self.photographs[0]} and are left out")
        tested = self.with_true_albedo(lit, lambda folder: folder / "albedo.png")
        for folder in self.kept(lit):
            view = self._view(folder, self._photo(folder), notes)
            novel.append(self.view(view))
            for path in sorted(folder.glob("rgba_*.png")):
                if self.is_novel(light := path.stem.removeprefix("rgba_")):
                    novel.append(self.view(self._view(folder, path, notes, light)))
            if folder not in tested:
                continue
            if truth:
                albedo = true_map(folder / "albedo.png", view.mask, "linear")
                view = replace(view, albedo=albedo, normal=true_normal(folder / "normal.png", view.mask))
            test.append(self.view(view))
        known = maps_below(self.lights, novel, notes, *self.own_light(*self._metadata(training[0]))) if truth else None
        return self.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _folders(self, split: str) -> Iterator[Path]:
        return (path for path in sorted(self.folder.glob(f"{split}_[0-9]*")) if path.is_dir())

    def _photo(self, folder: Path) -> Path:
        """The photograph under the training light, or where it should be."""
        places = [folder / name for name in self.photographs]
        return next((path for path in places if path.is_file()), places[0])

    def _metadata(self, folder: Path) -> tuple[str, dict[str, Any]]:
        path = file_below(self.folder, f"{folder.name}/metadata.json", str(self.folder))
        return str(path), read_json(path)

    def _view(self, folder: Path, path: Path, notes: list[str], light: str = "train") -> View:
        """The photograph ``path`` of a folder. Raises InputError, also for another size than the camera's."""
        where, fields = self._metadata(folder)
        width, height = int(number(where, fields, "imw")), int(number(where, fields, "imh"))
        focal = focal_of(where, "cam_angle_x", number(where, fields, "cam_angle_x"), width)
        said = text(where, fields, "cam_transform_mat", "")
        try:
            matrix = np.array([float(part) for part in said.split(",")]).reshape(4, 4)
        except ValueError:
            raise InputError(f"{where}: cam_transform_mat: expected 16 numbers with commas, found {shown(repr(said))}") from None
        to_world = rigid(where, "cam_transform_mat", matrix)
        photo = photograph(file_below(self.folder, f"{folder.name}/{path.name}", str(self.folder)), None, notes)
        expect_size(path, photo.mask.shape, (height, width), "imw and imh of metadata.json")
        camera = check_camera(where, Camera(to_world, (focal, focal), (0.5 * width, 0.5 * height), width, height))
        return photo.view(folder.name if light == "train" else f"{folder.name}_{light}", camera, light)


@dataclass(frozen=True, kw_only=True)
class NerfactorReader(ViewFolders):
    """Reads a synthetic scene of NeRFactor (Zhang et al., SIGGRAPH Asia 2021): folders train_NNN, val_NNN and test_NNN.

    Photographs are ``rgba.png``, under the map that metadata.json calls ``envmap`` *times* ``envmap_inten``; held-out views are
    also there under novel maps at strength 1, ``rgba_city.png`` and others, and under single point lights, ``rgba_olat-*.png``,
    which no environment map stands for and which are left out.
    """

    format = "nerfactor"
    held_out_splits = ("val", "test")
    photographs = ("rgba.png",)

    def is_novel(self, light: str) -> bool:
        """Whether it is a map."""
        return not light.startswith("olat")

    def own_light(self, where: str, metadata: dict[str, Any]) -> tuple[str, float]:
        """The map that metadata.json names, and its strength."""
        strength = positive(where, {"envmap_inten": 3.0} | metadata, "envmap_inten")
        if strength > BRIGHTEST:
            raise InputError(f"{where}: envmap_inten: expected a number up to {BRIGHTEST:g}, found {strength:g}")
        return Path(text(where, metadata, "envmap", "")).stem, strength


@dataclass(frozen=True, kw_only=True)
class TensoirReader(ViewFolders):
    """Reads a scene of TensoIR-Synthetic (Jin et al., CVPR 2023): folders train_NNN and test_NNN.

    Training and held-out photographs are ``rgba_sunset_000.png``: a light and the angle by which it was turned. Held-out views are
    also there under novel lights, ``rgba_bridge.png`` and others, whose maps are a download of their own: ``lights``.

    Attributes:
        light: What the training photographs were taken under ...
        rotation: ... turned by so many degrees.
    """

    format = "tensoir"
    light: str = "sunset"
    rotation: str | int = "000"

    @property
    def photographs(self) -> tuple[str, ...]:
        """The names of photographs under the training light."""
        return f"rgba_{self.light}_{self.turn}.png", f"rgba_{self.light}.png"

    @property
    def turn(self) -> str:
        """The rotation as it stands in names: without quotes ``rotation=060`` is a number."""
        return f"{self.rotation:03d}" if isinstance(self.rotation, int) else self.rotation

    def is_novel(self, light: str) -> bool:
        """Whether it is another light, which is not turned."""
        return light != self.light and not TURNED.search(light)

    def own_light(self, where: str, metadata: dict[str, Any]) -> tuple[str, float]:
        """The training light's map; a turned one is not among the files."""
        return (self.light if self.turn == "000" else ""), 1.0
