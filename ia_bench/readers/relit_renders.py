"""Readers of rendered scenes with true material: NeILF's and Synthetic4Relight.

Reader of NeILF's synthetic scenes (Yao et al., ECCV 2022): inputs/{images, position_maps, model/mesh.obj, sfm_scene.json}.

sfm_scene.json holds, by the number of a photograph, ``camera.extrinsic`` (16 numbers, world-to-camera, OpenCV's axes) and
``camera.intrinsic.focal`` and ``ppt`` in pixels; where ``flg`` is not 2 the photograph has no pose. Pixels at which position_maps
(or depth_maps) are 0 show no object. The scene is read in units of its bounding box, ``bbox.transform``.

Reader of Synthetic4Relight (InvRender, Zhang et al., CVPR 2022): transforms_train.json and transforms_test.json.

Training photographs are FILE_rgb.exr (linear) with FILE_mask.png. Held-out views are FILE_rgba.png (8-bit sRGB), FILE_albedo.png
(8-bit *linear*) and FILE_rough.png; under novel lights test_rli/LIGHT_NNN.png. The maps envmap3 (training), envmap6 and
envmap12 lie in InvRender's repository: ``lights``. The pictures are Blender's: the first pixel's centre is at (0.5, 0.5), and
InvRender's halving of all translations is no part of the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import camera, frames_of, from_world_to_camera, numbers, rigid, text
from ia_bench.readers.pictures import Encoding, Photo, expect_size, maps_below, photograph, true_map
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import read_exr, refuse_negative
from ia_bench.scenes.photograph import read_values
from ia_bench.scenes.scene import Camera, Scene, View

VALIDATION = (9, 18, 30, 41, 50, 62, 73, 82, 94)  # of the paper's configuration for the synthetic scenes
POSED = 2  # ``flg`` of a photograph with a pose
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # the mesh file has +y up, the cameras +z


@dataclass(frozen=True, kw_only=True)
class NeilfReader(FolderReader):
    """Reads the folder of one scene.

    Attributes:
        validation: Places in the list of photographs that are held out, counted modulo its length.
        albedo: How kd is stored.
    """

    format = "neilf"
    validation: Sequence[int] = VALIDATION
    albedo: Encoding = "linear"

    def read(self, truth: bool) -> Scene:
        """The scene; materials of held-out views only with ``truth``. Raises InputError."""
        inputs, materials = self.folder / "inputs", self.folder / "ground_truths" / "materials"
        content = _Described(str(inputs / "sfm_scene.json"), read_json(inputs / "sfm_scene.json"))
        box = content.numbers(16, "bbox", "transform").reshape(4, 4)
        middle, size = box[:3, 3], float(np.abs(np.diag(box)[:3]).max()) / 2
        if not size > 0:
            raise InputError(f"{content.path}: bbox.transform: expected a box with a size, found {np.diag(box)[:3].tolist()}")
        keys = sorted((key for key in content.at("image_path", "file_paths") if str(key).isdecimal()), key=int)
        held_out = {place % len(keys) for place in self.validation} if keys else set()

        def views(places: Sequence[int]) -> list[View]:
            posed = [keys[place] for place in places if content.at("camera_track_map", "images", keys[place], "flg") == POSED]
            return [self._view(content, key, middle, size) for key in posed]

        train = [self.view(view) for view in views([place for place in range(len(keys)) if place not in held_out])]
        seen = views(self.kept(sorted(held_out)))
        test = novel = [self.view(view) for view in seen]
        if truth:
            test = [self.view(self._with_truth(materials, view)) for view in seen]
        shift, own = np.eye(4), inputs / "model" / "mesh.obj"
        shift[:3, 3] = -middle
        place = np.diag([1 / size, 1 / size, 1 / size, 1.0]) @ shift @ (np.eye(4) if self.mesh else UPRIGHT)
        scene = self.scene(train=train, test=test, novel=novel, mesh=own if own.is_file() else None, place=place)
        return replace(scene, metallic=(materials / "metallic").is_dir())

    def _view(self, content: _Described, key: str, middle: np.ndarray, size: float) -> View:
        keys = "camera_track_map", "images", key, "camera"
        (fx, fy), (cx, cy) = (content.numbers(2, *keys, "intrinsic", kind).tolist() for kind in ("focal", "ppt"))
        extrinsic = content.numbers(16, *keys, "extrinsic").reshape(4, 4)
        to_world = from_world_to_camera(rigid(content.path, ".".join((*keys, "extrinsic")), extrinsic))
        to_world[:3, 3] = (to_world[:3, 3] - middle) / size
        name = Path(str(content.at("image_path", "file_paths", key))).stem
        photo = self._photo(content.path, name)
        height, width = photo.mask.shape
        return photo.view(name, Camera(to_world, (fx, fy), (cx, cy), width, height))

    def _photo(self, where: str, name: str) -> Photo:
        """The photograph, whose mask is where its position map or its depth map has a surface."""
        inputs = self.folder / "inputs"
        kind = "position_maps" if (inputs / "position_maps").is_dir() else "depth_maps"

        def values(folder: str, channels: int) -> tuple[Path, np.ndarray]:
            there = next((s for s in (".exr", ".png", ".jpg") if (inputs / folder / f"{name}{s}").is_file()), ".exr")
            path = file_below(inputs, f"{folder}/{name}{there}", where)
            return path, read_exr(path, channels) if there == ".exr" else read_values(path)[..., :3]

        (path, image), (surface, positions) = values("images", 3), values(kind, 3 if kind == "position_maps" else 1)
        encoded = path.suffix != ".exr"
        image, mask = srgb_to_linear(image) if encoded else image, (positions != 0).any(-1)
        refuse_negative(path, image)
        expect_size(surface, mask.shape, image.shape, str(path))
        return Photo.of(image.clip(min=0) * mask[..., None], mask, (image >= 1).any(-1) & encoded)

    def _with_truth(self, materials: Path, view: View) -> View:
        kd, rough = (materials / kind / f"{view.name}.png" for kind in ("kd", "roughness"))
        albedo = true_map(kd, view.mask, self.albedo)
        return replace(view, albedo=albedo, roughness=true_map(rough, view.mask, "linear", channels=1))


@dataclass(frozen=True)
class _Described:
    """The ``content`` of the JSON file ``path``, whose values lie under nested keys."""

    path: str
    content: dict[str, Any]

    def at(self, *keys: str) -> Any:  # noqa: ANN401 (JSON)
        """The value at the end of ``keys``. Raises InputError where there is none."""
        value: Any = self.content
        for place, key in enumerate(keys):
            if not isinstance(value, dict) or key not in value:
                raise InputError(f"{self.path}: expected {'.'.join(keys[: place + 1])}, found none")
            value = value[key]
        return value

    def numbers(self, count: int, *keys: str) -> np.ndarray:
        """The ``count`` numbers at the end of ``keys``. Raises InputError."""
        values = numbers(self.at(*keys)).ravel()
        if values.size != count or not np.isfinite(values).all():
            raise InputError(f"{self.path}: {'.'.join(keys)}: expected {count} finite numbers, found {self.at(*keys)!r:.100}")
        return values


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
        held_out = frames_of(folder / "transforms_test.json") if (folder / "transforms_test.json").is_file() else []
        for where, frame in self.kept(held_out):
            view = self._view(where, frame, "_rgba.png", notes)
            test.append(self.view(self._with_truth(where, frame, view) if truth else view))
            novel.append(self.view(view))
            for path in sorted((folder / RELIT).glob(f"*_{view.name}.png")):
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
        height, width = photo.mask.shape
        return photo.view(path.name.removesuffix(suffix), camera(where, frame, width, height))

    def _with_truth(self, where: str, frame: Mapping[str, Any], view: View) -> View:
        beside = self._file(where, frame, "_rgba.png").with_name
        albedo = true_map(beside(f"{view.name}_albedo.png"), view.mask, self.albedo)
        return replace(view, albedo=albedo, roughness=true_map(beside(f"{view.name}_rough.png"), view.mask, "linear", channels=1))
