"""Reader of Stanford-ORB (Kuang et al., NeurIPS 2023), its "blender" representation and its ground truth.

Below the dataset's folder lie blender_HDR/CAPTURE/{transforms_train,transforms_test,transforms_novel}.json with SPLIT/NNNN.exr and
SPLIT_mask/NNNN.png, and ground_truth/CAPTURE/{env_map, surface_normal, z_depth, pseudo_gt_albedo, mesh_blender}. Frames of
transforms_novel.json show the same object in another capture, ``scene_name``, with a field of view of their own; their light is
that capture's env_map/NNNN.exr, in the frame of the *camera*: the middle is where the camera looks, +y is up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ia_bench.common.errors import InputError, unknown
from ia_bench.common.files import file_below
from ia_bench.light.environment import turned
from ia_bench.readers.base import FolderReader
from ia_bench.readers.cameras import NamedFrame, camera, expect_each_once, frames_if_there, frames_of, photographs, text
from ia_bench.readers.contract import MESHES
from ia_bench.readers.pictures import masked_normal, photograph, true_map
from ia_bench.scenes.exr import read_light
from ia_bench.scenes.photograph import read_array
from ia_bench.scenes.scene import Scene, Truth, View

FOLDERS = {"hdr": "blender_HDR", "ldr": "blender_LDR"}
SUFFIX = {"hdr": ".exr", "ldr": ".png"}


@dataclass(frozen=True, kw_only=True)
class StanfordOrbReader(FolderReader):
    """Reads one capture of the dataset's folder.

    Attributes:
        shrink: 4 makes 512 x 512 pixels of 2048 x 2048, as the benchmark does.
        capture: Name of an object and a place, such as teapot_scene001.
        radiance: Linear OpenEXR photographs or 8-bit ones.
    """

    format = "stanford_orb"
    shrink: Annotated[int, Field(ge=1)] = 4
    capture: str | None = None
    radiance: Literal["hdr", "ldr"] = "hdr"

    def __post_init__(self) -> None:
        """Check the options. Raises InputError for no folder, and for a capture that is not there."""
        super().__post_init__()
        if not self._place.is_dir():
            raise InputError(f"{self.folder}: expected the dataset's folder, with {self._place.name} in it, found none")
        captures = sorted(folder.name for folder in self._place.iterdir() if folder.is_dir())
        if self.capture not in captures:
            raise InputError(unknown("reader.options.capture", self.capture or "null", captures))

    @property
    def label(self) -> str:
        """The capture."""
        return str(self.capture)

    @property
    def _place(self) -> Path:
        return self.folder / FOLDERS[self.radiance]

    @property
    def _truths(self) -> Path:
        return self.folder / "ground_truth"

    def places(self) -> Sequence[Path]:
        """The capture's photographs and truth, and the photographs and maps of other captures that it is relit with."""
        own, others = self._place / self.label, list[Path]()
        for where, frame in self._novel_frames():
            name, capture = Path(text(where, frame, "file_path", "")), text(where, frame, "scene_name", "")
            place = self._place / capture / name.parent
            others += [place / f"{name.name}{SUFFIX[self.radiance]}", place.with_name(f"{place.name}_mask") / f"{name.name}.png"]
            others.append(self._truths / capture / "env_map" / f"{name.name}.exr")
        return [own, self._truths / self.label, *others, *(self.folder / name for name in MESHES)]

    def read(self, truth: bool) -> Scene:
        """The capture; pseudo truth, scanned geometry and lights of other captures only with ``truth``. Raises InputError."""
        notes, own = list[str](), self._place / self.label
        training, others = (frames_of(own / f"transforms_{split}.json") for split in ("train", "test"))
        expect_each_once(photographs([*training, *others]))
        train = [self.view(self._view(self.label, *frame, notes)) for frame in training]
        seen, test, albedo = list[View](), list[View](), self._truths / self.label / "pseudo_gt_albedo"
        held_out = [(frame, Path(text(*frame, "file_path", "")).name) for frame in self.kept(others)]
        tested = self.with_true_albedo(held_out, *(lambda one, end=end: albedo / f"{one[1]}{end}" for end in (".png", ".npy")))
        for one in held_out:
            view = self._view(self.label, *one[0], notes)
            seen.append(self.view(view))
            if one in tested:
                test.append(self.view(self._with_truth(view)) if truth else seen[-1])
        lights: dict[str, np.ndarray] = {}
        for where, frame in self.kept(self._novel_frames()):
            name = text(where, frame, "scene_name", "")
            view = self._view(name, where, frame, notes)
            light = f"{name}_{view.name}"
            seen.append(self.view(replace(view, name=light, light=light)))
            path = self._truths / name / "env_map" / f"{view.name}.exr"
            if truth and path.is_file():
                lights[light] = turned(read_light(path), view.camera.to_world[:3, :3] @ CAMERA_LAYOUT.T)
            elif truth:
                notes.append(f"no environment map {path.relative_to(self.folder)}: the view under it is not relit")
        if truth and test and test[0].albedo is not None:
            notes.append("true albedo is pseudo truth: it is misaligned in places and darker than the scanned texture")
        scanned = self._truths / self.label / "mesh_blender" / "mesh.obj"
        mesh, known = scanned if scanned.is_file() else None, Truth(lights) if truth else None
        return self.scene(train=train, test=test, novel=seen, truth=known, notes=notes, mesh=mesh)

    def _novel_frames(self) -> list[NamedFrame]:
        return frames_if_there(self._place / self.label / "transforms_novel.json")

    def _view(self, capture: str, where: str, frame: Mapping[str, Any], notes: list[str]) -> View:
        name = Path(text(where, frame, "file_path", ""))
        place = f"{self._place.name}/{capture}/{name.parent}"
        path = file_below(self.folder, f"{place}/{name.name}{SUFFIX[self.radiance]}", f"{where}: file_path")
        photo = photograph(path, file_below(self.folder, f"{place}_mask/{name.name}.png", f"{where}: mask"), notes)
        return photo.view(name.name, camera(where, frame, photo.mask.shape))

    def _with_truth(self, view: View) -> View:
        """The view, of the photograph's size, with what ground_truth has of it; normals are there in the frame of the camera."""
        normal, depth = self._array("surface_normal", view, 3, 1.1), self._array("z_depth", view, 1, 1e6)
        albedo = true_map(self._truths / self.label / "pseudo_gt_albedo" / f"{view.name}.png", view.mask, "srgb")
        stored = self._array("pseudo_gt_albedo", view, 3, 1e3) if albedo is None else None
        if stored is not None:
            albedo = (stored.clip(0, 1) * view.mask[..., None]).astype(np.float32)
        return replace(
            view,
            albedo=albedo,
            normal=None if normal is None else masked_normal(normal @ view.camera.to_world[:3, :3].T, view.mask),
            depth=None if depth is None else (depth[..., 0].clip(min=0) * view.mask).astype(np.float32),
        )

    def _array(self, kind: str, view: View, channels: int, most: float) -> np.ndarray | None:
        """A .npy file at the photograph's size, (H, W, C); None where there is none. Raises InputError for anything else in it.

        An array up to ``shrink`` times smaller is repeated, to be multiplied by the coverage.
        """
        path, shape = self._truths / self.label / kind / f"{view.name}.npy", view.mask.shape
        if not path.is_file():
            return None
        values = read_array(path)
        values = values[..., None] if values.ndim == 2 else values
        block = max(shape[0] // max(len(values), 1), 1)
        fits = values.ndim == 3 and (block * values.shape[0], block * values.shape[1], values.shape[2]) == (*shape, channels)
        if not fits or block > self.shrink or np.abs(values).max() > most:
            found = f"{values.shape}, up to {np.abs(values).max(initial=0):.3g}"
            raise InputError(f"{path}: expected {(*shape, channels)} values from -{most:g} to {most:g}, found {found}")
        return values.repeat(block, 0).repeat(block, 1)


CAMERA_LAYOUT = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
"""From a camera's axes to those of our layout for a map whose middle column is where it looks, +y up, +x three quarters right."""
