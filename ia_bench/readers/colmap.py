"""Reader of COLMAP's sparse models (Schoenberger and Frahm, CVPR 2016), text or binary, by the package ``pycolmap``.

``sparse/0`` (or ``sparse``, or the folder itself) holds cameras, images and points; photographs lie in ``images/``, masks, white
where the object is, in ``masks/``. Poses are world-to-camera with OpenCV's axes; the first pixel's centre is at (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError, first_line
from ia_bench.common.files import file_below
from ia_bench.readers.distortion import Lens, undistorted
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.photo_lists import divided, mask_beside
from ia_bench.readers.pictures import expect_size, photograph
from ia_bench.readers.poses import from_world_to_camera
from ia_bench.scenes.scene import Camera, Scene, View

MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
"""The parameters of COLMAP's camera models that a pinhole camera and Brown's lens make up, in their order."""


class ColmapReader:
    """Reads a COLMAP project; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``images``, ``masks``: folders below the project's; ``every``: every so many-th photograph by name is held out.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 1,
        held_out: int | None = None,
        images: str = "images",
        masks: str = "masks",
        every: int = 8,
    ) -> None:
        self._intake = Intake.of("colmap", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        self._images, self._masks, self._every = images, masks, every

    def read(self, truth: bool) -> Scene:
        """The scene; such a project holds no truth. Raises InputError, also where pycolmap is not installed."""
        intake, notes = self._intake, list[str]()
        model = _model(intake.folder)
        posed = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
        if not posed:
            raise InputError(f"{intake.folder}: expected photographs with a pose in the sparse model, found none")

        def view(place: int) -> View:
            return self._view(posed[place], model.cameras[posed[place].camera_id], notes)

        train, test = divided(intake, len(posed), self._every, view)
        return intake.scene(train=train, test=test, novel=test, notes=notes)

    def _view(self, image: Any, lens: Any, notes: list[str]) -> View:  # noqa: ANN401 (pycolmap's, which need not be there)
        folder = self._intake.folder
        path = file_below(folder, f"{self._images}/{image.name}", f"{folder}: sparse model: image {image.image_id}")
        photo = photograph(path, mask_beside(folder / self._masks / Path(image.name).parent, path), notes)
        expect_size(path, photo.mask.shape, (lens.height, lens.width), f"camera {image.camera_id} of the sparse model")
        name = lens.model.name
        if name not in MODELS:
            known = ", ".join(MODELS)
            raise InputError(
                f"{folder}: sparse model: camera {image.camera_id}: expected one of {known}, found {name}; "
                "undistort the photographs first (colmap image_undistorter)"
            )
        values = dict(zip(MODELS[name], (float(value) for value in lens.params), strict=True))
        focal = (values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0)))
        glass = Lens(**{key: value for key, value in values.items() if key[0] in "kp"})
        to_camera = np.vstack([np.asarray(image.cam_from_world().matrix()), [0, 0, 0, 1]])
        camera = Camera(from_world_to_camera(to_camera), focal, (values["cx"], values["cy"]), lens.width, lens.height)
        return undistorted(str(path), photo.view(Path(image.name).with_suffix("").as_posix(), camera), glass)


def _model(folder: Path) -> Any:  # noqa: ANN401 (a pycolmap.Reconstruction)
    """The sparse model below ``folder``. Raises InputError."""
    package = _pycolmap()
    places = [folder / "sparse" / "0", folder / "sparse", folder]
    found = next((place for place in places for suffix in ("bin", "txt") if (place / f"cameras.{suffix}").is_file()), None)
    if found is None:
        raise InputError(f"{folder}: expected a sparse model (sparse/0/cameras.bin or .txt), found none")
    try:
        return package.Reconstruction(str(found))
    except (ValueError, RuntimeError, OSError) as error:
        raise InputError(f"{found}: expected a sparse model of COLMAP, found: {first_line(error)}") from None


def _pycolmap() -> ModuleType:
    try:
        import pycolmap
    except ImportError as error:
        raise InputError(f"reader=colmap needs the extra colmap (pip install -e '.[colmap]' in the checkout): {error}") from None
    found: ModuleType = pycolmap
    return found
