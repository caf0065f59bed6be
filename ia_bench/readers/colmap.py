"""Reader of COLMAP's sparse models (Schoenberger and Frahm, CVPR 2016), text or binary, by the package ``pycolmap``.

``sparse/0`` (or ``sparse``, or the folder itself) holds cameras, images and points; photographs lie in ``images/``, masks, white
where the object is, in ``masks/``. Poses are world-to-camera with OpenCV's axes; the first pixel's centre is at (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError, first_line
from ia_bench.common.files import file_below
from ia_bench.readers.base import UnsplitReader
from ia_bench.readers.cameras import Lens, expect_each_once, from_world_to_camera, rigid, undistorted
from ia_bench.readers.pictures import expect_size, mask_beside, photograph
from ia_bench.scenes.scene import Camera, Scene, View

MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
"""The parameters of COLMAP's camera models that a pinhole camera and Brown's lens make up, in their order."""


@dataclass(frozen=True, kw_only=True)
class ColmapReader(UnsplitReader):
    """Reads a COLMAP project.

    Attributes:
        images: Folder of the photographs, below the project's.
        masks: Folder of their masks.
    """

    format = "colmap"
    images: str = "images"
    masks: str = "masks"

    def read(self, truth: bool) -> Scene:
        """The scene; such a project holds no truth. Raises InputError, also where pycolmap is not installed."""
        notes = list[str]()
        model = self._model()
        posed = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
        if not posed:
            raise InputError(f"{self.folder}: expected photographs with a pose in the sparse model, found none")
        expect_each_once((f"{self.folder}: sparse model: image {image.image_id}", image.name) for image in posed)

        def view(place: int) -> View:
            return self._view(posed[place], model.cameras[posed[place].camera_id], notes)

        return self.unsplit(len(posed), view, notes)

    def _view(self, image: Any, lens: Any, notes: list[str]) -> View:  # noqa: ANN401 (pycolmap's, which need not be there)
        folder, where = self.folder, f"{self.folder}: sparse model: image {image.image_id}"
        path = file_below(folder, f"{self.images}/{image.name}", where)
        photo = photograph(path, mask_beside(folder / self.masks / Path(image.name).parent, path), notes)
        expect_size(path, photo.mask.shape, (lens.height, lens.width), f"camera {image.camera_id} of the sparse model")
        name = lens.model.name
        if name not in MODELS:
            raise InputError(
                f"{folder}: sparse model: camera {image.camera_id}: expected one of {', '.join(MODELS)}, found {name}; "
                "undistort the photographs first (colmap image_undistorter)"
            )
        values = dict(zip(MODELS[name], (float(value) for value in lens.params), strict=True))
        focal = (values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0)))
        glass = Lens(**{key: value for key, value in values.items() if key[0] in "kp"})
        pose = image.cam_from_world()
        quaternion = np.asarray(pose.rotation.quat, np.float64)
        if not abs(np.linalg.norm(quaternion) - 1) < 1e-3:  # of zeros, pycolmap makes no rotation at all
            raise InputError(f"{where}: expected a rotation as a unit quaternion, found {quaternion.tolist()}")
        to_camera = rigid(where, "pose", np.vstack([np.asarray(pose.matrix()), [0, 0, 0, 1]]))
        camera = Camera(from_world_to_camera(to_camera), focal, (values["cx"], values["cy"]), lens.width, lens.height)
        return undistorted(str(path), photo.view(Path(image.name).with_suffix("").as_posix(), camera), glass)

    def _model(self) -> Any:  # noqa: ANN401 (a pycolmap.Reconstruction)
        """The sparse model. Raises InputError."""
        try:
            import pycolmap as package
        except ImportError as error:
            raise InputError(f"reader=colmap needs the extra colmap (pip install -e '.[colmap]'): {error}") from None
        places = self.folder / "sparse" / "0", self.folder / "sparse", self.folder
        found = next((place for place in places for s in ("bin", "txt") if (place / f"cameras.{s}").is_file()), None)
        if found is None:
            raise InputError(f"{self.folder}: expected a sparse model (sparse/0/cameras.bin or .txt), found none")
        try:
            return package.Reconstruction(str(found))
        except (ValueError, RuntimeError, OSError) as error:
            raise InputError(f"{found}: expected a sparse model of COLMAP, found: {first_line(error)}") from None
