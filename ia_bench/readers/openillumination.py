"""Reader of OpenIllumination (Liu et al., NeurIPS 2023), the folder of one object below lighting_patterns/.

Photographs are Lights/PATTERN/raw_undistorted/CAMERA.JPG (8-bit sRGB). output/transforms_{train,test}.json have ``frames`` as an
object by camera: ``file_path``, ``camera_angle_x`` in radians across the photograph's width, ``transform_matrix``. Masks are
output/com_masks (object and support) for training and output/obj_masks (the object alone) for held-out views.

Two programs of the authors read transform_matrix with different axes. ``axes=auto`` takes those with which the cameras look at what
they surround.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from ia_bench.common.errors import InputError, unknown
from ia_bench.common.files import file_below
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import camera, expect_each_once, frames_of, number, photographs, share_away, text
from ia_bench.readers.contract import MESHES
from ia_bench.readers.pictures import maps_below, photograph
from ia_bench.scenes.exr import MAX_PIXELS
from ia_bench.scenes.scene import OPENCV_AXES, Scene, View

PHOTOS = "raw_undistorted"


@dataclass(frozen=True, kw_only=True)
class OpenIlluminationReader(FolderReader):
    """Reads the folder of one object.

    Attributes:
        pattern: The light of the training photographs.
        relight: Patterns of held-out photographs.
        lights: A folder of environment maps PATTERN.hdr, which third parties made and whose intensity is not calibrated.
        axes: Those of transform_matrix.
    """

    format = "openillumination"
    shrink: Annotated[int, Field(ge=1)] = 4
    pattern: str = "013"
    relight: list[str] | None = None
    lights: str | None = None
    axes: Literal["auto", "opencv", "opengl"] = "auto"

    def __post_init__(self) -> None:
        """Check the options. Raises InputError for no folder, and for a light that is not there."""
        super().__post_init__()
        there = self.folder / "Lights"
        if not there.is_dir():
            raise InputError(f"{self.folder}: expected the folder of one object, with Lights in it, found none")
        patterns = sorted(folder.name for folder in there.iterdir() if folder.is_dir())
        for key, name in (("pattern", self.pattern), *(("relight", name) for name in self.relight or ())):
            if name not in patterns:
                raise InputError(unknown(f"reader.options.{key}", name, patterns))

    def places(self) -> Sequence[Path]:
        """The photographs under the chosen lights, cameras, masks and mesh."""
        lights = [self.folder / "Lights" / name / PHOTOS for name in (self.pattern, *(self.relight or ()))]
        return [*lights, *(self.folder / name for name in ("output", *MESHES))]

    def read(self, truth: bool) -> Scene:
        """The scene; there is no truth of material, and maps of lights are read only with ``truth``. Raises InputError."""
        notes, place = list[str](), self.folder / "output"
        frames = {split: frames_of(place / f"transforms_{split}.json") for split in ("train", "test")}
        expect_each_once(photographs([*frames["train"], *frames["test"]]))
        read = [self.view(self._view(*frame, "train", self.pattern, notes)) for frame in frames["train"]]
        flip = self.axes == "opencv" or (self.axes == "auto" and share_away(read) > 0.5)
        if self.axes == "auto":
            axes = "OpenCV" if flip else "OpenGL"
            notes.append(f"transform_matrix read with the axes of {axes}: the cameras look at the object so")
        train = [_turned(view, flip) for view in read]
        test, novel = list[View](), list[View]()
        for frame in self.kept(frames["test"]):
            test.append(self.view(_turned(self._view(*frame, "test", self.pattern, notes), flip)))
            novel.append(test[-1])
            for name in self.relight or ():
                view = _turned(self._view(*frame, "test", name, notes), flip)
                novel.append(self.view(replace(view, name=f"{view.name}_{name}", light=name)))
        known = maps_below(self.lights, novel, notes, self.pattern) if truth else None
        return self.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _view(self, where: str, frame: Mapping[str, Any], split: str, pattern: str, notes: list[str]) -> View:
        name = Path(text(where, frame, "file_path", "")).stem
        path = file_below(self.folder, f"Lights/{pattern}/{PHOTOS}/{name}.JPG", f"{where}: file_path")
        masks = "com_masks" if split == "train" else "obj_masks"
        photo = photograph(path, file_below(self.folder, f"output/{masks}/{name}.png", f"{where}: mask"), notes)
        width = photo.mask.shape[1]
        calibrated = number(where, {"calib_imgw": width, **frame}, "calib_imgw")
        if not 0 < calibrated <= MAX_PIXELS:
            raise InputError(f"{where}: calib_imgw: expected a width up to {MAX_PIXELS} pixels, found {calibrated:g}")
        if calibrated % width:  # photographs may have been made smaller since they were calibrated
            raise InputError(f"{path}: expected calib_imgw = {calibrated:g}, as {where} says, or a part of it, found {width}")
        return photo.view(name, camera(where, frame, photo.mask.shape))


def _turned(view: View, flip: bool) -> View:
    return replace(view, camera=replace(view.camera, to_world=view.camera.to_world @ OPENCV_AXES)) if flip else view
