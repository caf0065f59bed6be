"""Reader of nerfstudio's and Blender-NeRF's folders: photographs with poses in transforms.json or transforms_SPLIT.json.

One ``transforms.json`` (nerfstudio, Instant-NGP) names the frames of each split under ``train_filenames``, ``val_filenames`` and
``test_filenames``; without ``train_filenames`` all others are for training, and without any every ``every``-th photograph is held
out. ``transforms_train.json`` and ``transforms_test.json`` (NeRF's Blender scenes) are splits of their own. No photograph may be in
both. A mask is the picture's alpha, its ``mask_path``, or ``masks/NAME.png``; that of images/left/NAME.png may also be
``masks/left/NAME.png``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json
from ia_bench.readers.base import FolderReader, expect_every
from ia_bench.readers.cameras import lens, undistorted
from ia_bench.readers.contract import MESHES
from ia_bench.readers.fields import Frame, camera, expect_each_once, frames_in, frames_of, number, photographs, plain
from ia_bench.readers.pictures import Notes, expect_size, photograph, picture_below
from ia_bench.scenes.scene import Scene, View

WHOLE, TRAINING, TESTING = "transforms.json", "transforms_train.json", "transforms_test.json"


@dataclass(frozen=True, kw_only=True)
class NerfstudioReader(FolderReader):
    """Reads a folder with transforms.json.

    Attributes:
        masks: The folder of the masks that have no ``mask_path``.
        every: Every so many-th photograph is held out where the file names no splits.
    """

    format = "nerfstudio"
    masks: str = "masks"
    every: int = 8

    def places(self) -> Sequence[Path]:
        """Lists of frames, the photographs and masks that they name, masks beside them, and the mesh."""
        names = [name for name in (WHOLE, TRAINING, TESTING, self.masks, *MESHES) if not (name == TRAINING and self._whole)]
        frames = [frame for split in self._splits(Notes()) for frame in split]
        photos = [picture_below(self.folder, frame.get("file_path"), f"{where}: file_path") for where, frame in frames]
        masks = [self.folder / str(frame["mask_path"]) for _, frame in frames if "mask_path" in frame]
        return [*(self.folder / name for name in names), *photos, *masks]

    def read(self, truth: bool) -> Scene:
        """The scene; such folders hold no truth, so held-out photographs are all that is scored. Raises InputError."""
        notes, read = Notes(), _Read()
        training, held_out = self._splits(notes)
        train = [self._view(*frame, notes, read) for frame in training]
        test = [self._view(*frame, notes, read) for frame in self.kept(held_out)]
        return self.scene(train=train, test=test, novel=test, notes=notes)

    @property
    def _whole(self) -> bool:
        return (self.folder / WHOLE).is_file()

    def _splits(self, notes: Notes) -> tuple[list[Frame], list[Frame]]:
        """The frames to fit and the frames that are held out."""
        folder = self.folder
        if not self._whole:
            if not (folder / TRAINING).is_file():
                raise InputError(f"{folder}: expected {WHOLE} or {TRAINING}, found neither")
            held_out = frames_of(folder / TESTING) if (folder / TESTING).is_file() else []
            training = frames_of(folder / TRAINING)
            expect_each_once(photographs([*training, *held_out]))
            return training, held_out
        content = read_json(folder / WHOLE)
        frames = frames_in(folder / WHOLE, content)
        splits = _splits_of(folder / WHOLE, content, frames)
        held_out = splits["test"] or splits["val"] or []
        if splits["train"] is not None:
            return splits["train"], held_out
        if held_out:
            withheld = {where for split in ("val", "test") for where, _ in splits[split] or ()}
            return [frame for frame in frames if frame[0] not in withheld], held_out
        expect_every(self.every)
        kept = [frame for place, frame in enumerate(frames) if place % self.every]
        notes.append(f"{WHOLE} names no splits: every {self.every}th of {len(frames)} photographs is held out")
        return kept, frames[:: self.every]

    def _view(self, where: str, frame: Mapping[str, Any], notes: Notes, read: _Read) -> View:
        folder = self.folder
        path = _spelled_below(folder, picture_below(folder, frame.get("file_path"), f"{where}: file_path"))
        photo = photograph(path, self._mask(where, path, frame, read), notes, self._mask_places(path)[0])
        height, width = photo.mask.shape
        for key, size in (("w", width), ("h", height)):
            if key in frame and number(where, frame, key) != size:
                raise InputError(f"{path}: expected {key} = {frame[key]:g}, as {where} says, found {size}")
        known = str([frame.get(key) for key in ("camera_angle_x", "fl_x", "fl_y", "cx", "cy")])
        first, like = read.sizes.setdefault(known, ((width, height), path))
        if (width, height) != first:  # one of them was cut or scaled
            expect_size(path, (height, width), first[::-1], f"{like.name} with the same intrinsics")
        view = photo.view(path.relative_to(folder).with_suffix("").as_posix(), camera(where, frame, width, height))
        return self.view(undistorted(where, view, lens(where, frame)))

    def _mask(self, where: str, path: Path, frame: Mapping[str, Any], read: _Read) -> Path | None:
        """The file of a photograph's mask, None where its alpha has to be it.

        Raises InputError for a file that its name makes the mask of another photograph, too.
        """
        if "mask_path" in frame:
            return file_below(self.folder, frame["mask_path"], f"{where}: mask_path")
        photo = plain(path.relative_to(self.folder))
        found = next((mask for mask in self._mask_places(path) if mask.is_file()), None)
        if found is not None and (other := read.masks.setdefault(found, photo)) != photo:
            raise InputError(
                f"{found}: expected the mask of one photograph, found that {other} and {photo} would share it; "
                f"put masks into folders ({self.masks}/left for images/left), or name each by mask_path"
            )
        return found

    def _mask_places(self, path: Path) -> list[Path]:
        """Where the mask of a photograph may lie, first the place that messages name."""
        photo, masks = Path(plain(path.relative_to(self.folder))), self.folder / self.masks
        names = (f"{path.stem}.png", f"{path.name}.png")  # COLMAP's own masks keep the suffix of the photograph
        return [place / name for place in (masks.joinpath(*photo.parent.parts[1:]), masks) for name in names]


@dataclass(frozen=True)
class _Read:
    """What was read so far: the size and the first photograph of intrinsics, the photograph of every mask."""

    sizes: dict[str, tuple[tuple[int, int], Path]] = field(default_factory=dict)
    masks: dict[Path, str] = field(default_factory=dict)


def _splits_of(path: Path, content: Mapping[str, Any], frames: Sequence[Frame]) -> dict[str, list[Frame] | None]:
    """The frames that the file names for each split, None where it does not. Raises InputError for a name that no frame has."""
    expect_each_once(photographs(frames))
    by_name = {plain(frame.get("file_path")): (where, frame) for where, frame in frames}
    named = {split: _named(path, content, f"{split}_filenames") for split in ("train", "val", "test")}
    for split, names in named.items():
        unknown = next((name for name in names or () if plain(name) not in by_name), None)
        if unknown is not None:
            raise InputError(f"{path}: {split}_filenames: expected file paths of frames, found {unknown!r}")
    read = ("train", "test" if named["test"] else "val")
    expect_each_once((f"{path}: {split}_filenames", name) for split in read for name in named[split] or ())
    return {split: None if names is None else [by_name[plain(name)] for name in names] for split, names in named.items()}


def _named(path: Path, content: Mapping[str, Any], key: str) -> list[str] | None:
    names = content.get(key)
    if names is not None and not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise InputError(f"{path}: {key}: expected a list of file paths, found {names!r:.100}")
    return names


def _spelled_below(folder: Path, path: Path) -> Path:
    """A file of the folder as a path below it, also where an absolute path leads there through a link."""
    return path if path.is_relative_to(folder) else folder / path.resolve().relative_to(folder.resolve())
