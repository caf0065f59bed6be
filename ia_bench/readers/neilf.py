"""Reader of NeILF's synthetic scenes (Yao et al., ECCV 2022): inputs/{images, position_maps, model/mesh.obj, sfm_scene.json}.

sfm_scene.json holds, by the number of a photograph, ``camera.extrinsic`` (16 numbers, world-to-camera, OpenCV's axes) and
``camera.intrinsic.focal`` and ``ppt`` in pixels; where ``flg`` is not 2 the photograph has no pose. Pixels at which position_maps
(or depth_maps) are 0 show no object. The scene is read in units of its bounding box, ``bbox.transform``.
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
from ia_bench.readers.cameras import from_world_to_camera
from ia_bench.readers.fields import numbers, rigid, text
from ia_bench.readers.pictures import Encoding, Notes, Photo, expect_size, true_map
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

    @property
    def _inputs(self) -> Path:
        return self.folder / "inputs"

    def read(self, truth: bool) -> Scene:
        """The scene; materials of held-out views only with ``truth``. Raises InputError."""
        path = self._inputs / "sfm_scene.json"
        content = read_json(path)
        box = _matrix(f"{path}: bbox.transform", _within(path, content, "bbox", "transform"))
        size = float(np.abs(np.diag(box)[:3]).max()) / 2
        if not size > 0:
            raise InputError(f"{path}: bbox.transform: expected a box with a size, found {np.diag(box)[:3].tolist()}")
        files = _within(path, content, "image_path", "file_paths")
        images = _within(path, content, "camera_track_map", "images")
        if not isinstance(files, dict) or not isinstance(images, dict):
            raise InputError(f"{path}: expected objects image_path.file_paths and camera_track_map.images, found another kind")
        keys = sorted((key for key in files if str(key).isdecimal()), key=int)
        held_out = {place % len(keys) for place in self.validation} if keys else set()

        def views(places: Sequence[int]) -> list[View]:
            posed = [key for key in (keys[place] for place in places) if _entry(path, images, key).get("flg") == POSED]
            named = {key: text(f"{path}: image_path.file_paths", files, key, "") for key in posed}
            return [self._view(path, key, named[key], images[key], box[:3, 3], size) for key in posed]

        train = [self.view(view) for view in views([place for place in range(len(keys)) if place not in held_out])]
        seen = views(self.kept(sorted(held_out)))
        novel = [self.view(view) for view in seen]
        test = [self.view(self._with_truth(view)) for view in seen] if truth else novel
        own, shift = self._inputs / "model" / "mesh.obj", np.eye(4)
        shift[:3, 3] = -box[:3, 3]
        place = np.diag([1 / size, 1 / size, 1 / size, 1.0]) @ shift @ (np.eye(4) if self.mesh else UPRIGHT)
        mesh = own if own.is_file() else None
        scene = self.scene(train=train, test=test, novel=novel, notes=Notes(), mesh=mesh, place=place)
        return replace(scene, metallic=(self._materials / "metallic").is_dir())

    @property
    def _materials(self) -> Path:
        return self.folder / "ground_truths" / "materials"

    def _view(self, path: Path, key: str, file: str, entry: Mapping[str, Any], middle: np.ndarray, size: float) -> View:
        where = f"{path}: camera_track_map.images[{key!r}]"
        intrinsic = _within(where, entry, "camera", "intrinsic")
        given = intrinsic if isinstance(intrinsic, dict) else {}
        pairs = [numbers(given.get(kind)).ravel() for kind in ("focal", "ppt")]
        if [pair.size for pair in pairs] != [2, 2] or not np.isfinite(pairs).all() or min(pairs[0]) <= 0:
            raise InputError(f"{where}: camera.intrinsic: expected two numbers each of focal and ppt, found {intrinsic!r:.100}")
        extrinsic = _matrix(f"{where}: camera.extrinsic", _within(where, entry, "camera", "extrinsic"))
        to_camera = rigid(where, "camera.extrinsic", extrinsic)
        to_world = from_world_to_camera(to_camera)
        to_world[:3, 3] = (to_world[:3, 3] - middle) / size
        name = Path(file).stem
        photo = self._photo(where, name)
        height, width = photo.mask.shape
        (fx, fy), (cx, cy) = (tuple(map(float, pair)) for pair in pairs)
        return photo.view(name, Camera(to_world, (fx, fy), (cx, cy), width, height))

    def _photo(self, where: str, name: str) -> Photo:
        """The photograph, whose mask is where its position map or its depth map has a surface."""
        path = self._map(where, "images", name)
        positions = "position_maps" if (self._inputs / "position_maps").is_dir() else "depth_maps"
        surface = self._map(where, positions, name)
        image = read_exr(path, 3) if path.suffix == ".exr" else srgb_to_linear(read_values(path)[..., :3])
        refuse_negative(path, image)
        if surface.suffix == ".exr":
            there = read_exr(surface, 3 if positions == "position_maps" else 1)
        else:
            there = read_values(surface)[..., :3]
        mask = (there != 0).any(-1)
        expect_size(surface, mask.shape, image.shape, str(path))
        if not mask.any():
            raise InputError(f"{surface}: expected a surface in some pixels, found 0 in all of them")
        clipped = (image >= 1).any(-1) & (path.suffix != ".exr")
        return Photo.of(image.clip(min=0) * mask[..., None], mask, clipped)

    def _map(self, where: str, kind: str, name: str) -> Path:
        suffixes = (".exr", ".png", ".jpg")
        found = next((suffix for suffix in suffixes if (self._inputs / kind / f"{name}{suffix}").is_file()), suffixes[0])
        return file_below(self._inputs, f"{kind}/{name}{found}", where)

    def _with_truth(self, view: View) -> View:
        kd, rough = (self._materials / kind / f"{view.name}.png" for kind in ("kd", "roughness"))
        albedo = true_map(kd, view.mask, self.albedo)
        return replace(view, albedo=albedo, roughness=true_map(rough, view.mask, "linear", channels=1))


def _within(where: Path | str, content: Any, *keys: str) -> Any:  # noqa: ANN401 (JSON)
    """The value at the end of nested ``keys``. Raises InputError, naming the first that is not there."""
    for place, key in enumerate(keys):
        if not isinstance(content, dict) or key not in content:
            raise InputError(f"{where}: expected {'.'.join(keys[: place + 1])}, found none")
        content = content[key]
    return content


def _entry(path: Path, images: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """What is said of the photograph ``key``. Raises InputError for none, and for anything but an object."""
    entry = _within(path, images, key)
    if not isinstance(entry, dict):
        raise InputError(f"{path}: camera_track_map.images[{key!r}]: expected an object, found {type(entry).__name__}")
    return entry


def _matrix(where: str, value: object) -> np.ndarray:
    values = numbers(value)
    if values.size != 16 or not np.isfinite(values).all():
        raise InputError(f"{where}: expected 16 finite numbers, found shape {values.shape}")
    return values.reshape(4, 4)
