"""Reader of Objects With Lighting (Ummenhofer et al., 3DV 2024), the folder OBJECT/test.

inputs/ holds image_NNNN.png, mask_NNNN.png, camera_NNNN.txt (rows of K, R, t, and width height channels; x = K (R X + t), OpenCV's
axes, the first pixel's centre at (0.5, 0.5)) and exposure.txt; beside it lie gt_image_NNNN.png and the rest of other places, each
with a map gt_env_512_rotated_NNNN.hdr in the world's frame, laid out as ours. A stored value is (x 2^exposure)^(1 / 2.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, shown
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import from_world_to_camera, rigid
from ia_bench.readers.contract import check_camera
from ia_bench.readers.pictures import tone_mapped
from ia_bench.scenes.exr import read_light
from ia_bench.scenes.photograph import expect_size
from ia_bench.scenes.scene import Camera, Scene, Truth, View

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
        train = [self.view(self._view("inputs/", one, exposure, f"inputs_{one}")) for one in numbers]
        novel, lights = list[View](), dict[str, np.ndarray]()
        for one in self.kept(sorted(path.stem.removeprefix("gt_image_") for path in folder.glob("gt_image_*.png"))):
            stops = _exposure(file_below(folder, f"gt_exposure_{one}.txt", str(folder)))
            novel.append(self.view(self._view("gt_", one, stops, f"gt_{one}", light=f"gt_{one}")))
            if truth:
                lights[f"gt_{one}"] = read_light(file_below(folder, f"gt_env_512_rotated_{one}.hdr", str(folder)))
        own = folder / "env_512_rotated.hdr"
        if truth and own.is_file():
            lights["train"] = read_light(own)
        return self.scene(train=train, novel=novel, truth=Truth(lights) if truth else None)

    def _view(self, before: str, place: str, stops: float, name: str, light: str = "train") -> View:
        path, mask, numbers = (
            file_below(self.folder, f"{before}{kind}_{place}.{suffix}", str(self.folder))
            for kind, suffix in (("image", "png"), ("mask", "png"), ("camera", "txt"))
        )
        camera = _camera(numbers)
        photo = tone_mapped(path, mask, lambda stored: stored**GAMMA * 2.0**-stops)
        expect_size(path, photo.mask.shape, (camera.height, camera.width), str(numbers))
        return photo.view(name, camera, light)


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
    pairs = (float(focal[0]), float(focal[1])), (float(centre[0]), float(centre[1]))
    return check_camera(str(path), Camera(to_world, *pairs, width, height))


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
