"""Photographs in a folder, with masks beside them and calibrated cameras, and every so many-th of them held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.readers.intake import Intake
from ia_bench.readers.pictures import SUFFIXES
from ia_bench.scenes.scene import View


def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder, by name; suffixes may be in upper case. Raises InputError for no folder and for an empty one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of photographs, found none")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not found:
        raise InputError(f"{folder}: expected photographs ({', '.join(SUFFIXES)}), found none")
    return found


def mask_beside(folder: Path, photo: Path) -> Path:
    """The mask of a photograph: NAME.png, or its whole name and .png, as COLMAP has it. Raises InputError where it is neither."""
    names = (f"{photo.stem}.png", f"{photo.name}.png", photo.name)
    found = next((path for name in names if (path := folder / name).is_file()), None)
    if found is None:
        raise InputError(f"{photo}: expected a mask {folder / names[0]}, found none")
    return found


def divided(intake: Intake, count: int, every: int, view: Callable[[int], View]) -> tuple[list[View], list[View]]:
    """Training views and held-out views, the ``every``-th ones from the first on, of ``count`` photographs.

    Raises InputError unless two at least are left to fit.
    """
    if every < 2:
        raise InputError(f"reader.options.every: expected 2 or more, found {every}")
    held_out: Sequence[int] = intake.kept(range(0, count, every))
    training = [place for place in range(count) if place % every]
    if len(training) < 2:
        raise InputError(f"{intake.folder}: expected at least 4 photographs, found {count}")
    return [intake.view(view(place)) for place in training], [intake.view(view(place)) for place in held_out]
