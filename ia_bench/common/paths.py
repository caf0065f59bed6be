"""Where files lie: those that come with the project, beside the package in a checkout or inside it, and results."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from ia_bench.common.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1]
SCENES_VARIABLE = "IA_BENCH_DATASETS"
MORE_SCENES = f"Either set {SCENES_VARIABLE} to the datasets folder of a checkout, or name a scene folder with scene.path=FOLDER"


def conf_folder() -> Path:
    """Folder of the Hydra configuration: ``ia_bench/conf`` in an installed package, ``conf`` in a checkout."""
    return _installed_or_beside("conf")


def scenes_folders() -> list[Path]:
    """Folders of scenes that exist, the first that has a scene first: those of ``$IA_BENCH_DATASETS``, with ``:`` between.

    Without that variable, the shipped scenes of a checkout, or ``tiny`` in an installed package.

    Raises InputError where there is none.
    """
    chosen = os.environ.get(SCENES_VARIABLE)
    datasets = [Path(part) for part in chosen.split(os.pathsep) if part] if chosen else [_installed_or_beside("datasets")]
    folders = [folder / "scenes" for folder in datasets]
    found = [folder for folder in folders if folder.is_dir()]
    if not found:
        where = f"{SCENES_VARIABLE}={chosen}" if chosen else "this installation"
        raise InputError(f"{', '.join(map(str, folders))}: {where} has no shipped scenes. {MORE_SCENES}")
    return found


def _installed_or_beside(name: str) -> Path:
    installed = PACKAGE / name
    return installed if installed.is_dir() else PACKAGE.parent / name


def make_writable(folder: Path, key: str) -> None:
    """Make ``folder`` and write into it, before any work is done for it. Raises InputError, naming ``key``, where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"{key}: {folder}: expected a folder that can be written, found: {error.strerror}") from None
