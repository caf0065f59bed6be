"""Reader of OpenIllumination (Liu et al., NeurIPS 2023), the folder of one object below lighting_patterns/.

Photographs are Lights/PATTERN/raw_undistorted/CAMERA.JPG (8-bit sRGB). output/transforms_{train,test}.json have ``frames`` as an
object by camera: ``file_path``, ``camera_angle_x`` in radians across the photograph's width, ``transform_matrix``. Masks are
output/com_masks (object and support) for training and output/obj_masks (the object alone) for held-out views.

Two programs of the authors read transform_matrix with different axes. ``axes=auto`` takes those with which the cameras look at what
they surround.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below
from ia_bench.common.suggestions import unknown
from ia_bench.readers.fields import camera, number, text
from ia_bench.readers.frames import frames_of
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.lights import lights_below
from ia_bench.readers.pictures import expect_size, photograph
from ia_bench.readers.poses import from_opencv, share_looking_away
from ia_bench.scenes.scene import Scene, Truth, View

PHOTOS = "raw_undistorted"


class OpenIlluminationReader:
    """Reads the folder of one object; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``pattern``: the light of the training photographs; ``relight``: patterns of held-out photographs; ``lights``: a folder of
    environment maps PATTERN.hdr, which third parties made and whose intensity is not calibrated; ``axes``: of transform_matrix.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 4,
        held_out: int | None = None,
        pattern: str = "013",
        relight: list[str] | None = None,
        lights: str | None = None,
        axes: Literal["auto", "opencv", "opengl"] = "auto",
    ) -> None:
        self._intake = Intake.of("openillumination", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        there = self._intake.folder / "Lights"
        if not there.is_dir():
            raise InputError(f"{self._intake.folder}: expected the folder of one object, with Lights in it, found none")
        patterns = sorted(folder.name for folder in there.iterdir() if folder.is_dir())
        for key, name in (("pattern", pattern), *(("relight", name) for name in relight or ())):
            if name not in patterns:
                raise InputError(unknown(f"reader.options.{key}", name, patterns))
        self._pattern, self._relight, self._lights, self._axes = pattern, relight or [], lights, axes

    def read(self, truth: bool) -> Scene:
        """The scene; there is no truth of material, and maps of lights are read only with ``truth``. Raises InputError."""
        intake, notes = self._intake, list[str]()
        place = intake.folder / "output"
        frames = {split: frames_of(place / f"transforms_{split}.json") for split in ("train", "test")}
        read = [self._view(*frame, "train", self._pattern, notes) for frame in frames["train"]]
        flip = self._flipped(read, notes)
        train = [intake.view(_turned(view, flip)) for view in read]
        test, novel = list[View](), list[View]()
        for frame in intake.kept(frames["test"]):
            test.append(intake.view(_turned(self._view(*frame, "test", self._pattern, notes), flip)))
            novel.append(test[-1])
            for name in self._relight:
                view = _turned(self._view(*frame, "test", name, notes), flip)
                novel.append(intake.view(replace(view, name=f"{view.name}_{name}", light=name)))
        known = None
        if truth:
            names = [self._pattern, *self._relight] if self._lights else []
            found, said = lights_below("reader.options.lights", self._lights, names)
            notes += said
            known = Truth({"train" if name == self._pattern else name: radiance for name, radiance in found.items()})
        return intake.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _flipped(self, views: list[View], notes: list[str]) -> bool:
        """Whether transform_matrix has OpenCV's axes."""
        if self._axes != "auto":
            return self._axes == "opencv"
        away = share_looking_away([view.camera.to_world for view in views])
        flipped = away is not None and away > 0.5
        notes.append(
            f"transform_matrix read with the axes of {'OpenCV' if flipped else 'OpenGL'}: the cameras look at the object so"
        )
        return flipped

    def _view(self, where: str, frame: Mapping[str, Any], split: str, pattern: str, notes: list[str]) -> View:
        folder = self._intake.folder
        name = Path(text(where, frame, "file_path", "")).stem
        if not name:
            raise InputError(f"{where}: file_path: expected the name of a camera's photograph, found none")
        path = file_below(folder, f"Lights/{pattern}/{PHOTOS}/{name}.JPG", f"{where}: file_path")
        mask = file_below(folder, f"output/{'com_masks' if split == 'train' else 'obj_masks'}/{name}.png", f"{where}: mask")
        photo = photograph(path, mask, notes)
        height, width = photo.mask.shape
        if "calib_imgw" in frame and (calibrated := number(where, frame, "calib_imgw")) % width:
            expect_size(path, (height, width), (height, int(calibrated)), f"calib_imgw of {where}")
        return photo.view(name, camera(where, frame, width, height))


def _turned(view: View, flip: bool) -> View:
    return replace(view, camera=replace(view.camera, to_world=from_opencv(view.camera.to_world))) if flip else view
