"""Where files lie: those that come with the project, beside the package in a checkout or inside it, and results."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from ia_bench.common.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1]
SCENES_VARIABLE = "IA_BENCH_DATASETS"


def conf_folder() -> Path:
    """Folder of the Hydra configuration: ``ia_bench/conf`` in an installed package, ``conf`` in a checkout."""
    installed = PACKAGE / "conf"
    return installed if installed.is_dir() else PACKAGE.parent / "conf"


def scenes_folder() -> Path:
    """Folder that holds the shipped scenes: ``$IA_BENCH_DATASETS/scenes``, or ``datasets/scenes`` of the checkout.

    Raises InputError where there is none, which is the case for a package installed without its checkout.
    """
    chosen = os.environ.get(SCENES_VARIABLE)
    folder = Path(chosen) / "scenes" if chosen else PACKAGE.parent / "datasets" / "scenes"
    if not folder.is_dir():
        where = f"{SCENES_VARIABLE}={chosen}" if chosen else "this installation"
        raise InputError(
            f"{folder}: {where} has no shipped scenes. Either set {SCENES_VARIABLE} to the datasets folder of a "
            "checkout, or name a scene folder with scene.path=FOLDER"
        )
    return folder


def make_writable(folder: Path, key: str) -> None:
    """Make ``folder`` and write into it, before any work is done for it. Raises InputError, naming ``key``, where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"{key}: {folder}: expected a folder that can be written, found: {error.strerror}") from None
