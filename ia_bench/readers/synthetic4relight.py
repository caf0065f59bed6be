"""Reader of Synthetic4Relight (InvRender, Zhang et al., CVPR 2022): transforms_train.json and transforms_test.json.

Training photographs are FILE_rgb.exr (linear) with FILE_mask.png. Held-out views are FILE_rgba.png (8-bit sRGB), FILE_albedo.png
(8-bit *linear*) and FILE_rough.png; under novel lights test_rli/LIGHT_NNN.png. The maps envmap3 (training), envmap6 and
envmap12 lie in InvRender's repository: ``lights``. The pictures are Blender's: the first pixel's centre is at (0.5, 0.5), and
InvRender's halving of all translations is no part of the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below
from ia_bench.readers.fields import camera, text
from ia_bench.readers.frames import frames_of
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.lights import lights_below
from ia_bench.readers.pictures import Encoding, expect_size, photograph, true_map
from ia_bench.scenes.scene import Scene, Truth, View

RELIT = "test_rli"


class Synthetic4RelightReader:
    """Reads the folder of one object; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``lights``: the folder of the environment maps; ``light``: the name of the training light's; ``albedo``: how albedo is stored.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 1,
        held_out: int | None = None,
        lights: str | None = None,
        light: str = "envmap3",
        albedo: Encoding = "linear",
    ) -> None:
        self._intake = Intake.of("synthetic4relight", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        self._lights, self._light, self._albedo = lights, light, albedo

    def read(self, truth: bool) -> Scene:
        """The scene; material of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        intake, notes = self._intake, list[str]()
        folder = intake.folder
        train = [intake.view(self._view(*frame, "_rgb.exr", notes)) for frame in frames_of(folder / "transforms_train.json")]
        test, novel = list[View](), list[View]()
        held_out = frames_of(folder / "transforms_test.json") if (folder / "transforms_test.json").is_file() else []
        for where, frame in intake.kept(held_out):
            view = self._view(where, frame, "_rgba.png", notes)
            test.append(intake.view(self._with_truth(where, frame, view) if truth else view))
            novel.append(intake.view(view))
            novel += [intake.view(self._relit(view, light, path, notes)) for light, path in self._novel(view).items()]
        known = self._truth(novel, notes) if truth else None
        return intake.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _file(self, where: str, frame: Mapping[str, Any], suffix: str) -> Path:
        name = text(where, frame, "file_path", "")
        if not name:
            raise InputError(f"{where}: file_path: expected the path of a photograph without its suffix, found none")
        return file_below(self._intake.folder, f"{name}{suffix}", f"{where}: file_path")

    def _view(self, where: str, frame: Mapping[str, Any], suffix: str, notes: list[str]) -> View:
        path = self._file(where, frame, suffix)
        mask = self._file(where, frame, "_mask.png") if suffix == "_rgb.exr" else None
        photo = photograph(path, mask, notes)
        height, width = photo.mask.shape
        return photo.view(path.name.removesuffix(suffix), camera(where, frame, width, height))

    def _with_truth(self, where: str, frame: Mapping[str, Any], view: View) -> View:
        beside = self._file(where, frame, "_rgba.png").with_name
        albedo, rough = beside(f"{view.name}_albedo.png"), beside(f"{view.name}_rough.png")
        return replace(
            view,
            albedo=true_map(albedo, view.mask, self._albedo) if albedo.is_file() else None,
            roughness=true_map(rough, view.mask, "linear", channels=1) if rough.is_file() else None,
        )

    def _novel(self, view: View) -> dict[str, Path]:
        found = sorted((self._intake.folder / RELIT).glob(f"*_{view.name}.png"))
        return {path.stem.removesuffix(f"_{view.name}"): path for path in found}

    def _relit(self, view: View, light: str, path: Path, notes: list[str]) -> View:
        photo = photograph(path, None, notes)
        expect_size(path, photo.mask.shape, view.mask.shape, "the view under the training light")
        return photo.view(f"{view.name}_{light}", view.camera, light)

    def _truth(self, novel: list[View], notes: list[str]) -> Truth:
        names = [self._light, *sorted({view.light for view in novel} - {"train"})]
        found, said = lights_below("reader.options.lights", self._lights, names)
        notes += said
        return Truth({"train" if light == self._light else light: radiance for light, radiance in found.items()})
