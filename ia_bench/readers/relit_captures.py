"""Readers of captures under several lights: OpenIllumination and Objects With Lighting.

Reader of OpenIllumination (Liu et al., NeurIPS 2023), the folder of one object below lighting_patterns/.

Photographs are Lights/PATTERN/raw_undistorted/CAMERA.JPG (8-bit sRGB). output/transforms_{train,test}.json have ``frames`` as an
object by camera: ``file_path``, ``camera_angle_x`` in radians across the photograph's width, ``transform_matrix``. Masks are
output/com_masks (object and support) for training and output/obj_masks (the object alone) for held-out views.

Two programs of the authors read transform_matrix with different axes. ``axes=auto`` takes those with which the cameras look at what
they surround.

Reader of Objects With Lighting (Ummenhofer et al., 3DV 2024), the folder OBJECT/test.

inputs/ holds image_NNNN.png, mask_NNNN.png, camera_NNNN.txt (rows of K, R, t, and width height channels; x = K (R X + t), OpenCV's
axes, the first pixel's centre at (0.5, 0.5)) and exposure.txt; beside it lie gt_image_NNNN.png and the rest of other places, each
with a map gt_env_512_rotated_NNNN.hdr in the world's frame, laid out as ours. A stored value is (x 2^exposure)^(1 / 2.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, shown
from ia_bench.common.suggestions import unknown
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import (
    camera,
    expect_each_once,
    frames_of,
    from_opencv,
    from_world_to_camera,
    number,
    photographs,
    rigid,
    share_away,
    text,
)
from ia_bench.readers.contract import MESHES
from ia_bench.readers.pictures import expect_size, maps_below, photograph, read_light, tone_mapped
from ia_bench.scenes.scene import Camera, Scene, Truth, View

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
    shrink: int = 4
    pattern: str = "013"
    relight: list[str] | None = None
    lights: str | None = None
    axes: Literal["auto", "opencv", "opengl"] = "auto"

    def __post_init__(self) -> None:
        """Check the options. Raises InputError for a light that is not there, too."""
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
        read = [self._view(*frame, "train", self.pattern, notes) for frame in frames["train"]]
        flip = self.axes == "opencv" or (self.axes == "auto" and share_away(read) > 0.5)
        if self.axes == "auto":
            axes = "OpenCV" if flip else "OpenGL"
            notes.append(f"transform_matrix read with the axes of {axes}: the cameras look at the object so")
        train = [self.view(_turned(view, flip)) for view in read]
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
        height, width = photo.mask.shape
        calibrated = number(where, {"calib_imgw": width, **frame}, "calib_imgw")
        if calibrated <= 0 or calibrated % width:  # photographs may have been made smaller since they were calibrated
            raise InputError(f"{path}: expected calib_imgw = {calibrated:g}, as {where} says, or a part of it, found {width}")
        return photo.view(name, camera(where, frame, width, height))


def _turned(view: View, flip: bool) -> View:
    return replace(view, camera=replace(view.camera, to_world=from_opencv(view.camera.to_world))) if flip else view


GAMMA = 2.2
STOPS = 32.0  # of any exposure; no camera is so fast or so slow


@dataclass(frozen=True, kw_only=True)
class ObjectsWithLightingReader(FolderReader):
    """Reads OBJECT/test."""

    format = "objects_with_lighting"

    @property
    def label(self) -> str:
        """The object."""
        return self.folder.parent.name

    def read(self, truth: bool) -> Scene:
        """The scene; there is no truth of material, and maps of lights are read only with ``truth``. Raises InputError."""
        folder = self.folder
        inputs = folder / "inputs"
        numbers = sorted(path.stem.removeprefix("image_") for path in inputs.glob("image_*.png"))
        if not numbers:
            raise InputError(f"{inputs}: expected photographs image_0000.png, image_0001.png, ..., found none")
        exposure = _exposure(file_below(inputs, "exposure.txt", str(inputs)))
        train = [self.view(self._view("inputs/", one, exposure)) for one in numbers]
        novel, lights = list[View](), dict[str, np.ndarray]()
        for one in self.kept(sorted(path.stem.removeprefix("gt_image_") for path in folder.glob("gt_image_*.png"))):
            stops = _exposure(file_below(folder, f"gt_exposure_{one}.txt", str(folder)))
            novel.append(self.view(self._view("gt_", one, stops, light=f"gt_{one}")))
            if truth:
                lights[f"gt_{one}"] = read_light(file_below(folder, f"gt_env_512_rotated_{one}.hdr", str(folder)))
        own = folder / "env_512_rotated.hdr"
        if truth and own.is_file():
            lights["train"] = read_light(own)
        return self.scene(train=train, novel=novel, truth=Truth(lights) if truth else None)

    def _view(self, before: str, place: str, stops: float, light: str = "train") -> View:
        path, mask, numbers = (
            file_below(self.folder, f"{before}{kind}_{place}.{suffix}", str(self.folder))
            for kind, suffix in (("image", "png"), ("mask", "png"), ("camera", "txt"))
        )
        camera = _camera(numbers)
        photo = tone_mapped(path, mask, lambda stored: stored**GAMMA * 2.0**-stops)
        expect_size(path, photo.mask.shape, (camera.height, camera.width), str(numbers))
        return photo.view(f"{before.strip('/')}_{place}".replace("gt__", "gt_"), camera, light)


def _camera(path: Path) -> Camera:
    """The camera of a file of 8 rows of 3 numbers. Raises InputError."""
    values = _numbers(path, (8, 3))
    intrinsic, to_camera = values[:3], np.eye(4)
    to_camera[:3, :3], to_camera[:3, 3] = values[3:6], values[6]
    to_world = from_world_to_camera(rigid(str(path), "rows 4 to 7", to_camera))
    focal, centre = (intrinsic[0, 0], intrinsic[1, 1]), (intrinsic[0, 2], intrinsic[1, 2])
    if min(focal) <= 0 or abs(intrinsic[0, 1]) > 1e-6 * focal[0]:
        raise InputError(f"{path}: rows 1 to 3: expected K with positive focal lengths and no skew, found {intrinsic.tolist()}")
    width, height = int(values[7, 0]), int(values[7, 1])
    return Camera(to_world, (float(focal[0]), float(focal[1])), (float(centre[0]), float(centre[1])), width, height)


def _exposure(path: Path) -> float:
    stops = _numbers(path, (1, 1)).item()
    if abs(stops) > STOPS:
        raise InputError(f"{path}: expected an exposure from -{STOPS:g} to {STOPS:g} stops, found {stops:g}")
    return float(stops)


def _numbers(path: Path, shape: tuple[int, int]) -> np.ndarray:
    try:
        values = np.loadtxt(path, ndmin=2)
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: expected rows of numbers, found {shown(' '.join(str(error).split()))}") from None
    if values.shape != shape or not np.isfinite(values).all():
        raise InputError(f"{path}: expected {shape[0]} x {shape[1]} finite numbers, found shape {values.shape}")
    return values
