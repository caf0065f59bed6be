"""Reader of Synthetic4Relight (InvRender, Zhang et al., CVPR 2022): transforms_train.json and transforms_test.json.

Training photographs are FILE_rgb.exr (linear) with FILE_mask.png. Held-out views are FILE_rgba.png (8-bit sRGB), FILE_albedo.png
(8-bit *linear*) and FILE_rough.png; under novel lights test_rli/LIGHT_NNN.png. The maps envmap3 (training), envmap6 and
envmap12 lie in InvRender's repository: ``lights``. The pictures are Blender's: the first pixel's centre is at (0.5, 0.5), and
InvRender's halving of all translations is no part of the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ia_bench.common.files import file_below
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import camera, frames_if_there, frames_of, text
from ia_bench.readers.pictures import Encoding, maps_below, photograph, true_map
from ia_bench.scenes.photograph import expect_size
from ia_bench.scenes.scene import Scene, View

RELIT = "test_rli"


@dataclass(frozen=True, kw_only=True)
class Synthetic4RelightReader(FolderReader):
    """Reads the folder of one object.

    Attributes:
        lights: The folder of the environment maps, LIGHT.hdr or LIGHT.exr; None relights nothing.
        light: The name of the training light's map.
        albedo: How albedo is stored.
    """

    format = "synthetic4relight"
    lights: str | None = None
    light: str = "envmap3"
    albedo: Encoding = "linear"

    def read(self, truth: bool) -> Scene:
        """The scene; material of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        notes, folder = list[str](), self.folder
        train = [self.view(self._view(*frame, "_rgb.exr", notes)) for frame in frames_of(folder / "transforms_train.json")]
        test, novel = list[View](), list[View]()
        held_out = frames_if_there(folder / "transforms_test.json")
        tested = self.with_true_albedo(held_out, lambda frame: folder / f"{frame[1].get('file_path')}_albedo.png")
        for where, frame in self.kept(held_out):
            view = self._view(where, frame, "_rgba.png", notes)
            if (where, frame) in tested:
                test.append(self.view(self._with_truth(where, frame, view) if truth else view))
            novel.append(self.view(view))
            for path in sorted((folder / RELIT).glob(f"[!.]*_{view.name}.png")):
                photo, light = photograph(path, None, notes), path.stem.removesuffix(f"_{view.name}")
                expect_size(path, photo.mask.shape, view.mask.shape, "the view under the training light")
                novel.append(self.view(photo.view(f"{view.name}_{light}", view.camera, light)))
        known = maps_below(self.lights, novel, notes, self.light) if truth else None
        return self.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _file(self, where: str, frame: Mapping[str, Any], suffix: str) -> Path:
        return file_below(self.folder, text(where, frame, "file_path", "") + suffix, f"{where}: file_path")

    def _view(self, where: str, frame: Mapping[str, Any], suffix: str, notes: list[str]) -> View:
        path = self._file(where, frame, suffix)
        photo = photograph(path, self._file(where, frame, "_mask.png") if suffix == "_rgb.exr" else None, notes)
        return photo.view(path.name.removesuffix(suffix), camera(where, frame, photo.mask.shape))

    def _with_truth(self, where: str, frame: Mapping[str, Any], view: View) -> View:
        beside = self._file(where, frame, "_rgba.png").with_name
        albedo = true_map(beside(f"{view.name}_albedo.png"), view.mask, self.albedo)
        return replace(view, albedo=albedo, roughness=true_map(beside(f"{view.name}_rough.png"), view.mask, "linear", channels=1))
