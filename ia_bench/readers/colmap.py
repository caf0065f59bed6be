"""Reader of COLMAP's sparse models (Schoenberger and Frahm, CVPR 2016), text or binary.

``sparse/0`` (or ``sparse``, or the folder itself) holds cameras and images; photographs lie in ``images/``, masks, white where the
object is, in ``masks/``. Poses are world-to-camera with OpenCV's axes; the first pixel's centre is at (0.5, 0.5).

Models are read here and not by the package pycolmap, which never returns from a binary file that ends too early.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, shown
from ia_bench.readers.base import UnsplitReader
from ia_bench.readers.cameras import expect_each_once, from_world_to_camera, rigid
from ia_bench.readers.contract import check_camera
from ia_bench.readers.lenses import Lens, undistorted
from ia_bench.readers.pictures import mask_beside, photograph
from ia_bench.scenes.photograph import expect_size
from ia_bench.scenes.scene import Camera, Scene, View

T = TypeVar("T")
MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
"""The parameters of COLMAP's camera models that a pinhole camera and Brown's lens make up, in their order."""
OTHERS = {
    "OPENCV_FISHEYE": 8, "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4, "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4, "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}  # fmt: skip
COUNTS = {**{name: len(parameters) for name, parameters in MODELS.items()}, **OTHERS}
"""How many parameters a model has, in the order of COLMAP's numbers of models."""
Sensor = tuple[str, int, int, tuple[float, ...]]
"""Model, width, height and parameters of a camera."""
Posed = tuple[str, int, tuple[float, ...], int]
"""Name and number of a photograph, its pose (a quaternion w, x, y, z and a translation, world-to-camera) and its camera."""


@dataclass(frozen=True, kw_only=True)
class ColmapReader(UnsplitReader):
    """Reads a COLMAP project.

    Attributes:
        images: Folder of the photographs, below the project's.
        masks: Folder of their masks; where there is none, alpha is the mask.
    """

    format = "colmap"
    images: str = "images"
    masks: str = "masks"

    def read(self, truth: bool) -> Scene:
        """The scene; such a project holds no truth. Raises InputError."""
        notes = list[str]()
        sensors, posed = self._model(notes)
        if not posed:
            raise InputError(f"{self.folder}: expected photographs with a pose in the sparse model, found none")
        expect_each_once((f"{self.folder}: sparse model: image {number}", name) for name, number, _, _ in posed)
        self.note_without_pose([f"{self.images}/{name}" for name, *_ in posed], notes)
        return self.unsplit(len(posed), lambda place: self._view(*posed[place], sensors, notes), notes)

    def _view(
        self, name: str, number: int, pose: tuple[float, ...], sensor: int, sensors: Mapping[int, Sensor], notes: list[str]
    ) -> View:
        folder, where, about = self.folder, f"{self.folder}: sparse model: image {number}", f"camera {sensor} of the sparse model"
        path, masks = file_below(folder, f"{self.images}/{name}", where), (folder / self.masks / name).parent
        photo = photograph(path, mask_beside(masks, path) if (folder / self.masks).is_dir() else None, notes, masks)
        if sensor not in sensors:
            raise InputError(f"{where}: expected {about}, found none")
        model, width, height, parameters = sensors[sensor]
        expect_size(path, photo.mask.shape, (height, width), about)
        if model not in MODELS or len(parameters) != len(MODELS[model]):
            raise InputError(
                f"{folder}: sparse model: camera {sensor}: expected one of {', '.join(MODELS)}, found {shown(model)} with "
                f"{len(parameters)} parameters; undistort the photographs first (colmap image_undistorter)"
            )
        values = dict(zip(MODELS[model], parameters, strict=True))
        focal = (values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0)))
        glass = Lens(**{key: value for key, value in values.items() if key[0] in "kp"})
        if not abs(np.linalg.norm(pose[:4]) - 1) < 1e-3:
            raise InputError(f"{where}: expected a rotation as a unit quaternion, found {list(pose[:4])}")
        from scipy.spatial.transform import Rotation  # here, for most scenes need none of scipy

        to_camera = np.eye(4)
        to_camera[:3, :3], to_camera[:3, 3] = Rotation.from_quat(np.roll(pose[:4], -1)).as_matrix(), pose[4:]
        to_world = from_world_to_camera(rigid(where, "pose", to_camera))
        camera = Camera(to_world, focal, (values["cx"], values["cy"]), width, height)
        check_camera(f"{where}: {about}", camera)
        return undistorted(str(path), photo.view(Path(name).with_suffix("").as_posix(), camera), glass)

    def _model(self, notes: list[str]) -> tuple[dict[int, Sensor], list[Posed]]:
        """The cameras, and the photographs by name, of the sparse model; ``notes`` are told of others. Raises InputError."""
        sparse = self.folder / "sparse"
        found = {place: path for place in (sparse / "0", sparse, self.folder, *sorted(sparse.glob("*")))
                 for suffix in ("txt", "bin") if (path := place / f"cameras.{suffix}").is_file()}  # fmt: skip
        if not found:
            raise InputError(f"{self.folder}: expected a sparse model (sparse/0/cameras.bin or .txt), found none")
        cameras, *others = found.values()
        notes += [f"{path.parent.relative_to(self.folder)} is another sparse model and left out" for path in others]
        images, binary = cameras.with_stem("images"), cameras.suffix == ".bin"
        sensors = _whole(cameras, _binary_sensors if binary else _text_sensors)
        return sensors, sorted(_whole(images, _binary_images if binary else _text_images))


def _whole(path: Path, read: Callable[[bytes], T]) -> T:
    """What ``read`` makes of a file of a sparse model. Raises InputError, naming it, for a damaged one."""
    try:
        return read(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, IndexError, struct.error):
        raise InputError(f"{path}: expected {path.stem} of a sparse model of COLMAP, found damaged or missing data") from None


def _text_sensors(content: bytes) -> dict[int, Sensor]:
    """A line a camera: number, model, width, height, parameters."""
    lines = [line.split() for line in content.decode("utf-8-sig").splitlines() if line.strip() and not line.startswith("#")]
    return {
        int(number): (model, int(width), int(height), tuple(map(float, values))) for number, model, width, height, *values in lines
    }


def _text_images(content: bytes) -> list[Posed]:
    """Two lines a photograph: number, pose, camera, name; then points, three numbers each."""
    images, lines = list[Posed](), iter(content.decode("utf-8-sig").splitlines())
    for line in lines:
        if line.strip() and not line.startswith("#"):
            number, *pose, sensor, name = line.strip().split(maxsplit=9)
            images.append((name, int(number), tuple(map(float, pose)), int(sensor)))
            points = [*map(float, next(lines, "").split())]  # numbers, and so not the next photograph
            if len(pose) != 7 or len(points) % 3:
                raise ValueError(name)
    return images


def _binary_sensors(content: bytes) -> dict[int, Sensor]:
    """Their count; then for each number, model, width, height, parameters."""
    sensors, models, place = dict[int, Sensor](), list(COUNTS), 8
    for _ in range(*struct.unpack_from("<Q", content)):
        number, model, width, height = struct.unpack_from("<IIQQ", content, place)
        count = COUNTS[models[model]]
        sensors[number] = models[model], width, height, struct.unpack_from(f"<{count}d", content, place + 24)
        place += 24 + 8 * count
    return sensors


def _binary_images(content: bytes) -> list[Posed]:
    """Their count; then for each number, pose, camera, name and a zero, count of points, points of 24 bytes."""
    images, place = list[Posed](), 8
    for _ in range(*struct.unpack_from("<Q", content)):
        number, *pose, sensor = struct.unpack_from("<I7dI", content, place)
        end = content.index(0, place + 64)
        images.append((content[place + 64 : end].decode(), number, tuple(pose), sensor))
        place = end + 9 + 24 * struct.unpack_from("<Q", content, end + 1)[0]
    if place > len(content):
        raise ValueError(place)
    return images
