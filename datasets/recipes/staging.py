"""A scene is rendered in a folder beside its place and moved there when it is complete, so no folder is ever a mixture."""

import fcntl
import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from recipe import Recipe

JOB = "job.json"
"""File of an unfinished folder that says what is being rendered there; a finished folder has none."""


def staging_folder(out: Path) -> Path:
    """Where the scene that will be `out` is rendered."""
    return out.with_name(f".{out.name}.rendering")


def begin(out: Path, recipe: Recipe) -> Path:
    """Make or find the staging folder of `out` for `recipe`; files that are there are kept.

    Raises:
        ValueError: if an unfinished render of something else is there.
    """
    folder, job = staging_folder(out), json.loads(json.dumps(asdict(recipe)))
    folder.mkdir(parents=True, exist_ok=True)
    place, written = os.open(folder, os.O_RDONLY), folder / f".{JOB}"
    try:
        fcntl.flock(place, fcntl.LOCK_EX)  # another run may begin meanwhile
        if not (folder / JOB).exists():
            written.write_text(json.dumps(job))
            written.replace(folder / JOB)  # whole, or not at all
    finally:
        os.close(place)
    found: dict[str, Any] = json.loads((folder / JOB).read_text())
    if found != job:
        different = ", ".join(f"{key} {found.get(key)!r}" for key in job if found.get(key) != job[key])
        raise ValueError(
            f"{folder}: holds an unfinished render with {different}; finish it by its own command, or remove the folder"
        )
    return folder


def publish(folder: Path, out: Path) -> None:
    """Move a complete staging folder to `out`; what was there is removed once the new one is in place."""
    for leftover in (*folder.rglob(".*"), folder / JOB):  # half-written by a run that was killed, locks, the job
        leftover.unlink(missing_ok=True)
    previous = out.with_name(f".{out.name}.previous")
    shutil.rmtree(previous, ignore_errors=True)
    if out.exists():
        out.rename(previous)
    folder.rename(out)
    shutil.rmtree(previous, ignore_errors=True)
