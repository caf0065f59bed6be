"""Reader of NeILF's synthetic scenes (Yao et al., ECCV 2022): inputs/{images, position_maps, model/mesh.obj, sfm_scene.json}.

sfm_scene.json holds, by the number of a photograph, ``camera.extrinsic`` (16 numbers, world-to-camera, OpenCV's axes) and
``camera.intrinsic.focal`` and ``ppt`` in pixels; where ``flg`` is not 2 the photograph has no pose. Pixels at which position_maps
(or depth_maps) are 0 show no object. The scene is read in units of its bounding box, ``bbox.transform``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import from_world_to_camera, numbers, rigid
from ia_bench.readers.contract import check_camera
from ia_bench.readers.pictures import Encoding, Photo, true_map
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import expect_radiance, read_exr
from ia_bench.scenes.photograph import expect_size, read_values
from ia_bench.scenes.scene import FROM_Y_UP, Camera, Scene, View

VALIDATION = (9, 18, 30, 41, 50, 62, 73, 82, 94)  # of the paper's configuration for the synthetic scenes
POSED = 2  # ``flg`` of a photograph with a pose


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
        path = str(inputs / "sfm_scene.json")
        content = read_json(Path(path))
        box = _numbers(path, content, 16, "bbox", "transform").reshape(4, 4)
        middle, size = box[:3, 3], float(np.abs(np.diag(box)[:3]).max()) / 2
        if not size > 0:
            raise InputError(f"{path}: bbox.transform: expected a box with a size, found {np.diag(box)[:3].tolist()}")
        paths = _at(path, content, "image_path", "file_paths")
        if not isinstance(paths, dict):
            raise InputError(f"{path}: image_path.file_paths: expected an object, found {type(paths).__name__}")
        keys = sorted((key for key in paths if key.isdecimal()), key=int)
        held_out = {place % len(keys) for place in self.validation} if keys else set()

        def views(places: Sequence[int]) -> Iterator[View]:
            tracked = [(keys[place], _at(path, content, "camera_track_map", "images", keys[place], "flg")) for place in places]
            return (self._view(path, content, key, middle, size) for key, flag in tracked if flag == POSED)

        train = [self.view(view) for view in views([place for place in range(len(keys)) if place not in held_out])]
        test, novel = list[View](), list[View]()
        for view in views(self.kept(sorted(held_out))):
            novel.append(self.view(view))
            test.append(self.view(self._with_truth(materials, view)) if truth else novel[-1])
        shift, own = np.eye(4), inputs / "model" / "mesh.obj"
        shift[:3, 3] = -middle
        upright = np.eye(4) if self.mesh else FROM_Y_UP  # its own has +y up, the cameras +z
        place = np.diag([1 / size, 1 / size, 1 / size, 1.0]) @ shift @ upright
        scene = self.scene(train=train, test=test, novel=novel, mesh=own if own.is_file() else None, place=place)
        return replace(scene, metallic=(materials / "metallic").is_dir())

    def _view(self, where: str, content: Any, key: str, middle: np.ndarray, size: float) -> View:  # noqa: ANN401 (JSON)
        image = "camera_track_map", "images", key
        keys = *image, "camera"
        (fx, fy), (cx, cy) = (_numbers(where, content, 2, *keys, "intrinsic", kind).tolist() for kind in ("focal", "ppt"))
        extrinsic = _numbers(where, content, 16, *keys, "extrinsic").reshape(4, 4)
        to_world = from_world_to_camera(rigid(where, ".".join((*keys, "extrinsic")), extrinsic))
        to_world[:3, 3] = (to_world[:3, 3] - middle) / size
        name = Path(str(_at(where, content, "image_path", "file_paths", key))).stem
        photo = self._photo(where, name)
        height, width = photo.mask.shape
        calibrated = _at(where, content, *image).get("size", [width, height])  # in either order
        if sorted(numbers(calibrated).ravel().tolist()) != sorted([width, height]):
            found = f"expected that of photograph {name}, {width} x {height}, found {calibrated!r:.100}"
            raise InputError(f"{where}: {'.'.join(image)}.size: {found}")
        camera = Camera(to_world, (fx, fy), (cx, cy), width, height)
        return photo.view(name, check_camera(f"{where}: {'.'.join((*keys, 'intrinsic'))}", camera))

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
        expect_radiance(path, image)
        expect_size(surface, mask.shape, image.shape, str(path))
        return Photo.of(image.clip(min=0) * mask[..., None], mask, (image >= 1).any(-1) & encoded)

    def _with_truth(self, materials: Path, view: View) -> View:
        kd, rough = (materials / kind / f"{view.name}.png" for kind in ("kd", "roughness"))
        albedo = true_map(kd, view.mask, self.albedo)
        return replace(view, albedo=albedo, roughness=true_map(rough, view.mask, "linear", channels=1))


def _at(path: str, content: Any, *keys: str) -> Any:  # noqa: ANN401 (JSON)
    """The value at the end of nested ``keys`` of the file ``path``. Raises InputError where there is none."""
    for place, key in enumerate(keys):
        if not isinstance(content, dict) or key not in content:
            raise InputError(f"{path}: expected {'.'.join(keys[: place + 1])}, found none")
        content = content[key]
    return content


def _numbers(path: str, content: Any, count: int, *keys: str) -> np.ndarray:  # noqa: ANN401 (JSON)
    """The ``count`` numbers at the end of ``keys``. Raises InputError."""
    found = _at(path, content, *keys)
    values = numbers(found).ravel()
    if values.size != count or not np.isfinite(values).all():
        raise InputError(f"{path}: {'.'.join(keys)}: expected {count} finite numbers, found {found!r:.100}")
    return values
