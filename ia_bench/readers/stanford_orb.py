"""Reader of Stanford-ORB (Kuang et al., NeurIPS 2023), its "blender" representation and its ground truth.

Below the dataset's folder lie blender_HDR/CAPTURE/{transforms_train,transforms_test,transforms_novel}.json with SPLIT/NNNN.exr and
SPLIT_mask/NNNN.png, and ground_truth/CAPTURE/{env_map, surface_normal, z_depth, pseudo_gt_albedo, mesh_blender}. Frames of
transforms_novel.json show the same object in another capture, ``scene_name``, with a field of view of their own; their light is
that capture's env_map/NNNN.exr, in the frame of the *camera*: the middle is where the camera looks, +y is up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below
from ia_bench.common.suggestions import unknown
from ia_bench.readers.fields import camera, text
from ia_bench.readers.frames import frames_of
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.lights import read_light, resampled
from ia_bench.readers.pictures import fitted, photograph, true_map
from ia_bench.scenes.scene import Camera, Scene, Truth, View

FOLDERS = {"hdr": "blender_HDR", "ldr": "blender_LDR"}
SUFFIX = {"hdr": ".exr", "ldr": ".png"}


class StanfordOrbReader:
    """Reads one ``capture`` of the dataset's folder; options that all readers share are those of Intake.

    ``radiance``: linear OpenEXR photographs or 8-bit ones; ``shrink=4`` makes 512 x 512 pixels of 2048 x 2048, as the benchmark.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        capture: str | None = None,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 4,
        held_out: int | None = None,
        radiance: Literal["hdr", "ldr"] = "hdr",
    ) -> None:
        self._intake = Intake.of("stanford_orb", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        self._place, self._suffix = self._intake.folder / FOLDERS[radiance], SUFFIX[radiance]
        if not self._place.is_dir():
            raise InputError(f"{self._intake.folder}: expected the dataset's folder, with {FOLDERS[radiance]} in it, found none")
        captures = sorted(folder.name for folder in self._place.iterdir() if folder.is_dir())
        if capture not in captures:
            raise InputError(unknown("reader.options.capture", capture or "null", captures))
        self._capture = capture
        self._truths = self._intake.folder / "ground_truth"

    def read(self, truth: bool) -> Scene:
        """The capture; pseudo truth, scanned geometry and lights of other captures only with ``truth``. Raises InputError."""
        intake, notes = self._intake, list[str]()
        own = self._place / str(self._capture)
        train = [intake.view(self._view(self._capture, *frame, notes)) for frame in frames_of(own / "transforms_train.json")]
        held_out = [self._view(self._capture, *frame, notes) for frame in intake.kept(frames_of(own / "transforms_test.json"))]
        seen = [intake.view(view) for view in held_out]
        test = [intake.view(self._with_truth(view)) for view in held_out] if truth else list(seen)
        lights: dict[str, np.ndarray] = {}
        for where, frame in intake.kept(self._novel_frames(own)):
            name = text(where, frame, "scene_name", "")
            view = self._view(name, where, frame, notes)
            light = f"{name}_{view.name}"
            seen.append(intake.view(replace(view, name=light, light=light)))
            if truth:
                lights |= self._light(light, name, view, notes)
        if truth and test and test[0].albedo is not None:
            notes.append("true albedo is pseudo truth: it is misaligned in places and darker than the scanned texture")
        scanned = self._truths / str(self._capture) / "mesh_blender" / "mesh.obj"
        mesh = scanned if scanned.is_file() else None
        known = Truth(lights) if truth else None
        return intake.scene(train=train, test=test, novel=seen, truth=known, notes=notes, mesh=mesh, name=self._capture)

    def _novel_frames(self, own: Path) -> list[tuple[str, Mapping[str, Any]]]:
        path = own / "transforms_novel.json"
        return frames_of(path) if path.is_file() else []

    def _view(self, capture: str | None, where: str, frame: Mapping[str, Any], notes: list[str]) -> View:
        folder = self._intake.folder
        name = Path(text(where, frame, "file_path", ""))
        place = f"{self._place.name}/{capture}/{name.parent}"
        path = file_below(folder, f"{place}/{name.name}{self._suffix}", f"{where}: file_path")
        mask = file_below(folder, f"{place}_mask/{name.name}.png", f"{where}: mask")
        photo = photograph(path, mask, notes)
        height, width = photo.mask.shape
        return photo.view(name.name, camera(where, frame, width, height))

    def _with_truth(self, view: View) -> View:
        """The view, of the photograph's size, with what ground_truth has of it; normals are there in the frame of the camera."""
        albedo = next(
            (path for s in (".png", ".npy") if (path := self._file("pseudo_gt_albedo", f"{view.name}{s}")).is_file()), None
        )
        normal, depth = self._array("surface_normal", view, 3), self._array("z_depth", view, 1)
        if normal is not None:
            normal = normal @ view.camera.to_world[:3, :3].T
            normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1)
        return replace(
            view,
            albedo=None if albedo is None else self._albedo(albedo, view),
            normal=None if normal is None else (normal * view.mask[..., None]).astype(np.float32),
            depth=None if depth is None else (depth[..., 0].clip(min=0) * view.mask).astype(np.float32),
        )

    def _file(self, kind: str, name: str) -> Path:
        return self._truths / str(self._capture) / kind / name

    def _array(self, kind: str, view: View, channels: int) -> np.ndarray | None:
        path = self._file(kind, f"{view.name}.npy")
        return _loaded(path, view.mask.shape, channels, self._intake.shrink) if path.is_file() else None

    def _albedo(self, path: Path, view: View) -> np.ndarray:
        if path.suffix == ".npy":
            return (_loaded(path, view.mask.shape, 3, self._intake.shrink).clip(0, 1) * view.mask[..., None]).astype(np.float32)
        return true_map(path, view.mask, "srgb")

    def _light(self, light: str, capture: str, view: View, notes: list[str]) -> dict[str, np.ndarray]:
        path = self._truths / capture / "env_map" / f"{view.name}.exr"
        if not path.is_file():
            notes.append(f"no environment map {path.relative_to(self._intake.folder)}: the view under it is not relit")
            return {}
        return {light: from_camera_frame(read_light(path), view.camera)}


def from_camera_frame(radiance: np.ndarray, camera: Camera) -> np.ndarray:
    """A map whose middle column is where the camera looks, +y up and +x three quarters to the right, in the world's layout."""

    def look_up(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = np.moveaxis(directions @ camera.to_world[:3, :3], -1, 0)  # rows of R are the world's axes in the camera
        return (np.arctan2(x, -z) + np.pi) / (2 * np.pi), np.arccos(y.clip(-1, 1)) / np.pi

    return resampled(radiance, look_up)


def _loaded(path: Path, shape: tuple[int, ...], channels: int, shrink: int) -> np.ndarray:
    """An array of a .npy file at the photograph's size ``shape``, (H, W, C). Raises InputError for anything else in it.

    An array up to ``shrink`` times smaller is repeated, to be multiplied by the photograph's coverage; a larger one is averaged.
    """
    try:
        values = np.load(path, allow_pickle=False).astype(np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: expected an array of numbers (.npy), found {error}") from None
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[-1] != channels or not np.isfinite(values).all():
        raise InputError(f"{path}: expected finite values (H, W, {channels}), found {values.shape}")
    block = shape[0] // max(len(values), 1)
    if 1 < block <= shrink and shape == (block * values.shape[0], block * values.shape[1]):
        values = values.repeat(block, 0).repeat(block, 1)
    return fitted(path, values, shape)
