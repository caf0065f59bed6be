"""``cells.json`` of a table's results: which cells it consists of, for whoever wants to know how far it is."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.record import METRICS_FILE
from ia_bench.runs.table import Cell

CELLS = "cells.json"


@dataclass(frozen=True)
class Planned:
    """One cell: its labels, the hash of its configuration, its run folder, and the file with what it says."""

    row: str
    scene: str
    seed: int
    config_hash: str
    folder: Path
    log: Path


@dataclass(frozen=True)
class CellList:
    """The cells of a table in their order, how many run at a time (None: as many as fit), and when it was started last."""

    table: str
    jobs: int | None
    started: float
    cells: tuple[Planned, ...]


def write_cells(results: Path, table: str, jobs: int | None, cells: Sequence[Cell]) -> None:
    """Write down the cells of a table that is about to run in the folder ``results``."""
    listed = [
        {
            "row": cell.row.name,
            "scene": cell.config.scene.name,
            "seed": cell.config.seed,
            "config_hash": cell.config_hash,
            "folder": cell.folder.relative_to(results).as_posix(),
            "log": cell.log(results / "logs").relative_to(results).as_posix(),
        }
        for cell in cells
    ]
    results.mkdir(parents=True, exist_ok=True)
    with whole_file(results / CELLS) as partial:
        partial.write_text(json.dumps({"table": table, "jobs": jobs, "cells": listed}, indent=1), encoding="utf-8")


def read_cells(results: Path) -> CellList | None:
    """What :func:`write_cells` wrote into ``results``; None where it did not. Raises InputError for anything else there."""
    path = results / CELLS
    if not path.is_file():
        return None
    content = read_json(path)
    try:
        cells = tuple(_planned(results, entry) for entry in content["cells"])
        return CellList(content["table"], content["jobs"], path.stat().st_mtime, cells)
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: expected the cells of a table, found one without {error}") from None


def folders_with_cells(roots: Sequence[Path], note: Callable[[str], object]) -> dict[Path, tuple[str, str, int] | None]:
    """Every run folder below ``roots`` -> its row, scene and seed by the table that made it; None where no table lists any.

    Where a folder holds the cells of a table, its other runs are left out, and ``note`` is told how many: they are of rows, scenes,
    seeds or settings that were asked for before. A cell without a record has no label: it has not ended.
    """
    found: dict[Path, tuple[str, str, int] | None] = dict.fromkeys(find_run_folders(*roots))
    for results in sorted({path.parent for root in roots for path in root.rglob(CELLS)}):
        plan = read_cells(results)
        cells = {cell.folder: (cell.row, cell.scene, cell.seed) for cell in plan.cells} if plan is not None else {}
        others = [folder for folder in found if folder.is_relative_to(results) and folder not in cells]
        for folder in others:
            del found[folder]
        if others:
            many = f"{len(others)} {'run is' if len(others) == 1 else 'runs are'}"
            note(
                f"{results}: {many} left out, since {CELLS} there, of the table's last call, does not list more; "
                f"the runs of all calls: {results / 'runs'}"
            )
        found |= {folder: cell for folder, cell in cells.items() if (folder / METRICS_FILE).is_file()}
    return found


def _planned(results: Path, entry: dict[str, Any]) -> Planned:
    of = {key: entry[key] for key in ("row", "scene", "seed", "config_hash")}
    return Planned(**of, folder=results / entry["folder"], log=results / entry["log"])
