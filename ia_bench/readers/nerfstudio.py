"""Reader of nerfstudio's and Blender-NeRF's folders: photographs with poses in transforms.json or transforms_SPLIT.json.

One ``transforms.json`` (nerfstudio, Instant-NGP) names the frames of each split under ``train_filenames``, ``val_filenames``
and ``test_filenames``; without ``train_filenames`` all others are for training. ``transforms_train.json`` and
``transforms_test.json`` (NeRF's Blender scenes) are splits of their own. No photograph may be in both. Where none are for
testing, every ``every``-th is held out, but a single one is fitted. A mask is the picture's alpha, its ``mask_path``, or
``masks/NAME.png``; that of images/left/NAME.png may also be ``masks/left/NAME.png`` or ``masks/images/left/NAME.png``. The
``exposure`` of a frame, time x ISO / F-number squared in any unit, replaces what EXIF says, of all photographs where one frame has
it: EXIF's unit may be another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json
from ia_bench.readers.base import UnsplitReader
from ia_bench.readers.cameras import (
    NamedFrame,
    camera,
    expect_each_once,
    expect_size_of,
    frames_if_there,
    frames_of,
    photographs,
    plain,
    positive,
)
from ia_bench.readers.lenses import lens, undistorted
from ia_bench.readers.pictures import mask_named, photograph, picture_below
from ia_bench.scenes.photograph import expect_size
from ia_bench.scenes.scene import Scene, View

WHOLE, SPLIT = "transforms.json", ("transforms_train.json", "transforms_test.json")
Sizes = dict[str, tuple[str, tuple[int, ...]]]
"""By intrinsics, the name of the first photograph that has them, and its height and width."""


@dataclass(frozen=True, kw_only=True)
class NerfstudioReader(UnsplitReader):
    """Reads a folder with transforms.json. ``every`` counts where no photographs are named, or there, to be held out.

    Attributes:
        masks: The folder of the masks that have no ``mask_path``.
    """

    format = "nerfstudio"
    masks: str = "masks"

    def read(self, truth: bool) -> Scene:
        """The scene; such folders hold no truth, so held-out photographs are all that is scored. Raises InputError."""
        notes, sizes, masks = list[str](), Sizes(), dict[Path, str]()
        training, held_out = self._splits(notes)
        told = any("exposure" in frame for _, frame in (*training, *held_out))
        train = [self._view(*frame, notes, sizes, masks, told) for frame in training]
        test = [self._view(*frame, notes, sizes, masks, told) for frame in self.kept(held_out)]
        expect_each_once((str(self.folder), view.name) for view in (*train, *test))  # paths may name one in two ways
        return self.scene(train=train, test=test, novel=test, notes=notes)

    def _splits(self, notes: list[str]) -> tuple[list[NamedFrame], list[NamedFrame]]:
        """The frames to fit and the frames that are held out."""
        path = self.folder / WHOLE
        if not path.is_file():
            paths = [self.folder / name for name in SPLIT]
            if not paths[0].is_file():
                raise InputError(f"{self.folder}: expected {WHOLE} or {SPLIT[0]}, found neither")
            training, held_out = map(frames_if_there, paths)
            expect_each_once(photographs([*training, *held_out]))
            if any(self._is_there(frame) for _, frame in held_out):
                return training, held_out
            if held_out:  # BlenderNeRF writes cameras alone
                notes.append(f"{SPLIT[1]}: none of its {len(held_out)} photographs is there")
            return self._held_out_of(training, SPLIT[0], notes)
        content, frames = read_json(path), frames_of(path)
        others = [value for _, frame in frames for key, value in frame.items() if key.endswith("_path") and key != "file_path"]
        self.note_without_pose([frame.get("file_path", "") for _, frame in frames], notes, others)
        by_name = {plain(frame.get("file_path")): (where, frame) for where, frame in frames}
        named: dict[str, list[str]] = {}
        for key in ("train_filenames", "val_filenames", "test_filenames"):
            names = content.get(key, [])
            if not isinstance(names, list) or not {plain(name) for name in names} <= by_name.keys():
                raise InputError(f"{path}: {key}: expected a list of file paths of frames, found {names!r:.200}")
            named[key] = [plain(name) for name in names]
        train, val, test = named.values()
        expect_each_once((f"{path}: {key}", name) for key in ("train_filenames", "test_filenames" if test else "val_filenames")
                         for name in named[key])  # fmt: skip
        if "train_filenames" not in content:
            train = [name for name in by_name if name not in (*test, *val)]
        training = [by_name[name] for name in train]
        if test or val:
            return training, [by_name[name] for name in test or val]
        return self._held_out_of(training, WHOLE, notes)

    def _held_out_of(self, frames: list[NamedFrame], name: str, notes: list[str]) -> tuple[list[NamedFrame], list[NamedFrame]]:
        if len(frames) == 1:  # which is to be fitted
            return frames, []
        notes.append(f"{name} names no test photographs: every {self.every}th of {len(frames)} is held out")
        return self.split(frames)

    def _is_there(self, frame: Mapping[str, Any]) -> bool:
        try:
            return bool(picture_below(self.folder, frame.get("file_path"), ""))
        except InputError:
            return False

    def _view(
        self, where: str, frame: Mapping[str, Any], notes: list[str], sizes: Sizes, masks: dict[Path, str], told: bool
    ) -> View:
        """The view of a frame; ``masks``: of which photograph each is; ``told``: exposures are those of frames, and not of EXIF."""
        path = picture_below(self.folder, frame.get("file_path"), f"{where}: file_path")
        name = path.relative_to(self.folder) if path.is_relative_to(self.folder) else Path("..")
        if ".." in name.parts:  # it leads out of the folder and back; an absolute one may do so through a link
            name = path.resolve().relative_to(self.folder.resolve())
            path = self.folder / name
        mask = self._mask(where, name, frame)
        if mask is not None and "mask_path" not in frame and masks.setdefault(mask, str(name)) != str(name):
            own = self.folder / self.masks / name.parent / f"{name.stem}.png"
            raise InputError(
                f"{mask}: expected the mask of one photograph, found it for {masks[mask]} and {name}; there is no {own}"
            )
        photo = photograph(path, mask, notes, self.folder / self.masks)
        expect_size_of(where, frame, path, photo.mask.shape)
        if told:
            photo = replace(photo, exposure=positive(where, frame, "exposure") if "exposure" in frame else None)
        view = photo.view(name.with_suffix("").as_posix(), camera(where, frame, photo.mask.shape))
        intrinsics = str([frame.get(key) for key in ("camera_angle_x", "fl_x", "fl_y", "cx", "cy", "w", "h")])
        first, size = sizes.setdefault(intrinsics, (view.name, view.mask.shape))
        expect_size(path, view.mask.shape, size, f"{first} with the same intrinsics")  # one was cut or scaled
        return self.view(undistorted(where, view, lens(where, frame)))

    def _mask(self, where: str, photo: Path, frame: Mapping[str, Any]) -> Path | None:
        """The file of a photograph's mask, None where its alpha has to be it."""
        if "mask_path" in frame:
            return file_below(self.folder, frame["mask_path"], f"{where}: mask_path")
        masks = self.folder / self.masks
        places = masks / photo.parent, masks.joinpath(*photo.parent.parts[1:]), masks
        return next(filter(None, (mask_named(place, photo) for place in places)), None)
