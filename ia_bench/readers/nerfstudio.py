"""Reader of nerfstudio's and Blender-NeRF's folders: photographs with poses in transforms.json or transforms_SPLIT.json.

One ``transforms.json`` (nerfstudio, Instant-NGP) names the frames of each split under ``train_filenames``, ``val_filenames`` and
``test_filenames``; without ``train_filenames`` all others are for training, and without any every ``every``-th photograph is held
out. ``transforms_train.json`` and ``transforms_test.json`` (NeRF's Blender scenes) are splits of their own. No photograph may be in
both. A mask is the picture's alpha, its ``mask_path``, or ``masks/NAME.png``; that of images/left/NAME.png may also be
``masks/left/NAME.png``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, read_json
from ia_bench.readers.distortion import lens, undistorted
from ia_bench.readers.fields import camera, number
from ia_bench.readers.frames import Frame, frames_in, frames_of
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.pictures import photograph, picture_below
from ia_bench.scenes.scene import Scene, View

WHOLE, TRAINING, TESTING = "transforms.json", "transforms_train.json", "transforms_test.json"


class NerfstudioReader:
    """Reads a folder with transforms.json; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``masks``: the folder of the masks that have no ``mask_path``; ``every``: every so many-th photograph is held out where the
    file names no splits.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 1,
        held_out: int | None = None,
        masks: str = "masks",
        every: int = 8,
    ) -> None:
        self._intake = Intake.of("nerfstudio", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        if every < 2:
            raise InputError(f"reader.options.every: expected 2 or more, found {every}")
        self._masks, self._every = masks, every

    def read(self, truth: bool) -> Scene:
        """The scene; such folders hold no truth, so held-out photographs are all that is scored. Raises InputError."""
        intake, notes = self._intake, list[str]()
        self._sizes = dict[str, tuple[tuple[int, int], Path]]()
        self._masked = dict[Path, Path]()
        training, held_out = self._splits(notes)
        train = [self._view(*frame, notes) for frame in training]
        test = [self._view(*frame, notes) for frame in intake.kept(held_out)]
        return intake.scene(train=train, test=test, novel=test, notes=notes)

    def _splits(self, notes: list[str]) -> tuple[list[Frame], list[Frame]]:
        """The frames to fit and the frames that are held out."""
        folder = self._intake.folder
        if not (folder / WHOLE).is_file():
            if not (folder / TRAINING).is_file():
                raise InputError(f"{folder}: expected {WHOLE} or {TRAINING}, found neither")
            held_out = frames_of(folder / TESTING) if (folder / TESTING).is_file() else []
            training = frames_of(folder / TRAINING)
            _expect_each_once(_photographs([*training, *held_out]))
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
        kept = [frame for place, frame in enumerate(frames) if place % self._every]
        notes.append(f"{WHOLE} names no splits: every {self._every}th of {len(frames)} photographs is held out")
        return kept, frames[:: self._every]

    def _view(self, where: str, frame: Mapping[str, Any], notes: list[str]) -> View:
        folder = self._intake.folder
        path = _spelled_below(folder, picture_below(folder, frame.get("file_path"), f"{where}: file_path"))
        photo = photograph(path, self._mask(where, path, frame), notes, self._places(path)[0])
        height, width = photo.mask.shape
        for key, size in (("w", width), ("h", height)):
            if key in frame and number(where, frame, key) != size:
                raise InputError(f"{path}: expected {key} = {frame[key]:g}, as {where} says, found {size}")
        self._expect_same_size(path, frame, (width, height))
        view = photo.view(path.relative_to(folder).with_suffix("").as_posix(), camera(where, frame, width, height))
        return self._intake.view(undistorted(where, view, lens(where, frame)))

    def _expect_same_size(self, path: Path, frame: Mapping[str, Any], size: tuple[int, int]) -> None:
        """Raise InputError for photographs of different size with the same intrinsics: one of them was cut or scaled."""
        known = str([frame.get(key) for key in ("camera_angle_x", "fl_x", "fl_y", "cx", "cy")])
        first, like = self._sizes.setdefault(known, (size, path))
        if size != first:
            found = f"{size[0]} x {size[1]}"
            raise InputError(
                f"{path}: expected {first[0]} x {first[1]} pixels like {like.name} with the same intrinsics, found {found}"
            )

    def _mask(self, where: str, path: Path, frame: Mapping[str, Any]) -> Path | None:
        """The file of a photograph's mask, None where its alpha has to be it.

        Raises InputError for a file that its name makes the mask of another photograph, too.
        """
        folder = self._intake.folder
        if "mask_path" in frame:
            return file_below(folder, frame["mask_path"], f"{where}: mask_path")
        photo = Path(os.path.normpath(path.relative_to(folder)))
        found = next((mask for mask in self._places(path) if mask.is_file()), None)
        if found is not None and (other := self._masked.setdefault(found, photo)) != photo:
            both = f"{other.as_posix()} and {photo.as_posix()}"
            raise InputError(
                f"{found}: expected the mask of one photograph, found that {both} would share it; "
                f"put masks into folders ({self._masks}/left for images/left), or name each by mask_path"
            )
        return found

    def _places(self, path: Path) -> list[Path]:
        """Where the mask of a photograph may lie, first the place that messages name."""
        folder = self._intake.folder
        photo, masks = Path(os.path.normpath(path.relative_to(folder))), folder / self._masks
        names = (f"{path.stem}.png", f"{path.name}.png")  # COLMAP's own masks keep the suffix of the photograph
        return [place / name for place in (masks.joinpath(*photo.parent.parts[1:]), masks) for name in names]


def _splits_of(path: Path, content: Mapping[str, Any], frames: Sequence[Frame]) -> dict[str, list[Frame] | None]:
    """The frames that the file names for each split, None where it does not. Raises InputError for a name that no frame has."""
    _expect_each_once(_photographs(frames))
    by_name = {_plain(frame.get("file_path")): (where, frame) for where, frame in frames}
    named = {split: _named(path, content, f"{split}_filenames") for split in ("train", "val", "test")}
    for split, names in named.items():
        unknown = next((name for name in names or () if _plain(name) not in by_name), None)
        if unknown is not None:
            raise InputError(f"{path}: {split}_filenames: expected file paths of frames, found {unknown!r}")
    read = ("train", "test" if named["test"] else "val")
    _expect_each_once((f"{path}: {split}_filenames", name) for split in read for name in named[split] or ())
    return {split: None if names is None else [by_name[_plain(name)] for name in names] for split, names in named.items()}


def _photographs(frames: Iterable[Frame]) -> Iterator[tuple[str, str]]:
    """Where each photograph of ``frames`` is named, and how. What is no text is told of where it is opened."""
    named = ((f"{where}: file_path", frame.get("file_path")) for where, frame in frames)
    return ((where, name) for where, name in named if isinstance(name, str))


def _expect_each_once(named: Iterable[tuple[str, str]]) -> None:
    """Raise InputError for a photograph that comes twice: it would count twice, or be scored although it was fitted."""
    known: dict[str, str] = {}
    for where, name in named:
        first = known.get(_plain(name))
        if first is not None:
            found = f"{name!r} twice" if first == where else f"{name!r} again, as in {first}"
            raise InputError(f"{where}: expected every photograph once, found {found}")
        known[_plain(name)] = where


def _named(path: Path, content: Mapping[str, Any], key: str) -> list[str] | None:
    names = content.get(key)
    if names is not None and not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise InputError(f"{path}: {key}: expected a list of file paths, found {names!r:.100}")
    return names


def _plain(name: object) -> str:
    """A path without ``./`` and the like, to be compared."""
    return os.path.normpath(str(name))


def _spelled_below(folder: Path, path: Path) -> Path:
    """A file of the folder as a path below it, also where an absolute path leads there through a link."""
    return path if path.is_relative_to(folder) else folder / path.resolve().relative_to(folder.resolve())
