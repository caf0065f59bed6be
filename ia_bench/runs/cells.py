"""The cells of a table: every row x capture x scene x seed as a run, ``cells.json``, which lists them, and how far they are.

Which run, wait, finished and failed is only read from files; nothing is asked of the runs.
"""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.ranges import Name
from ia_bench.common.registry import BrokenPlugin
from ia_bench.common.settings import parsed_file
from ia_bench.runs.composition import compose, written
from ia_bench.runs.config import RunConfig, SceneConfig, cell_name
from ia_bench.runs.folder import find_run_folders, held_since, recorded_at
from ia_bench.runs.identity import hash_of, identity
from ia_bench.runs.launchers import Local
from ia_bench.runs.record import METRICS_FILE, RunRecord
from ia_bench.runs.table import Row, SceneEntry, Table, key_of, load_table, rows_in, some_rows, title_of

CELLS = "cells.json"
RUNNING, WAITING, FAILED, FINISHED = "running", "waiting", "failed", "finished"
PROGRESS = re.compile(r"^(.+: \d+/\d+, .*)$", re.MULTILINE)  # as common.progress writes it where nobody draws bars
TAIL_BYTES = 4096  # of a log, in which the last line of progress is looked for
LONGEST = 255  # bytes of a file's name


@dataclass(frozen=True)
class TableRequest:
    """The command line: which table, what replaces its scenes and seeds, how many jobs, overrides for every cell, and where.

    ``table``: a name, or a FILE.yaml. ``rows``: which of its rows, None for all (:func:`rows_in`).
    """

    table: str = "paper"
    scenes: tuple[str, ...] | None = None
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] | None = None
    jobs: Annotated[int, Field(ge=1)] | None = None
    overrides: tuple[str, ...] = ()
    launcher: Local = field(default_factory=Local)
    rows: str | None = None

    @property
    def name(self) -> str:
        """What the table is called, and the folder of its results."""
        return title_of(self.table)

    def load(self) -> Table:
        """The table with the rows that are asked for. Raises InputError as :func:`load_table`, and for what a row sets itself."""
        table = load_table(self.table)
        if self.rows is not None:
            table = some_rows(table, rows_in(self.rows, table))
        for row in table.crossed_rows:
            own = {key_of(text) for text in row.overrides}
            if both := [text for text in self.overrides if key_of(text) in own]:
                raise InputError(f"{both[0]}: expected a setting that no row has of its own, found it in row '{row.name}'")
        return table


def _place(path: Path) -> Path:
    """A path as :func:`write_cells` writes it; any other one could not be asked about, or leads out of the table's results."""
    fits = all(len(part.encode()) <= LONGEST for part in path.parts)
    if not fits or not str(path).isprintable() or path.is_absolute() or ".." in path.parts:
        raise PydanticCustomError("place", "a path below the table's results")
    return path


Place = Annotated[Path, AfterValidator(_place)]


@dataclass(frozen=True)
class ListedCell:
    """One run of the table: its labels, the hash of its identity, its folder, and the file with what it says."""

    row: Name
    scene: Name
    seed: int
    config_hash: str
    folder: Place
    log: Place

    @property
    def name(self) -> str:
        """How messages call this cell."""
        return f"{self.scene} / {self.row} / seed {self.seed}"

    @property
    def labels(self) -> tuple[str, str, int]:
        """By which a report knows it."""
        return self.row, self.scene, self.seed


@dataclass(frozen=True)
class Cell(ListedCell):
    """One that can be run: its configuration, with the command line that makes it, and its identity."""

    config: RunConfig
    content: dict[str, Any]


def make_cells(
    table: Table, request: TableRequest, threads: int, results: Path, broken: Callable[[str], None] | None = None
) -> list[Cell]:
    """Every row x capture x scene x seed, composed and checked; row after row, so that jobs side by side differ in scene.

    The request's seeds replace the table's. A row whose prior or method cannot be used has no cell: ``broken`` is told why, once.
    Raises InputError where there is no cell, or one twice, and for such a row where nobody is told.
    """
    seeds, scenes = table.seeds if request.seeds is None else request.seeds, table.entries(request.scenes)
    for what, asked in (("seeds", seeds), ("scenes", [scene.name for scene in scenes])):
        if twice := [one for one, count in Counter(asked).items() if count > 1]:
            raise InputError(f"{what}: expected each once, found {twice[0]} more than once")

    def overrides_of(row: Row, scene: SceneEntry, seed: int) -> list[str]:
        own = (*scene.overrides, f"seed={seed}", f"threads={threads}", f"row={written(row.name)}")
        return [*row.overrides, *own, *request.overrides]

    by_name: dict[str, SceneConfig] = {}  # scenes that a name alone gives

    def composed(row: Row, seed: int, *, alone: bool) -> list[RunConfig]:
        """Its configurations with all scenes: composing takes long, and with scenes by name nothing but the scene differs.

        ``alone``: each is composed all the same.
        """
        first: RunConfig | None = None
        found = []
        for scene in scenes:
            if first is not None and scene.name in by_name and not alone:
                found.append(replace(first, scene=by_name[scene.name]))
                continue
            found.append(compose(overrides_of(row, scene, seed), here=request.launcher.here))
            if scene == SceneEntry(scene.name):
                first, by_name[scene.name] = found[-1], found[-1].scene
        return found

    cells = []
    for row in table.crossed_rows:
        given = [*row.overrides, *request.overrides, *(text for scene in scenes for text in scene.overrides)]
        filled_in = any("${" in text for text in given)  # with the scene's name, say, or the seed
        try:
            known = {seed: composed(row, seed, alone=filled_in) for seed in (seeds if filled_in else [0])}
            for seed, place in product(seeds, range(len(scenes))):
                scene, config = scenes[place], known[seed if filled_in else 0][place]
                config = replace(config, seed=seed)  # on which nothing else of it depends, unless it was composed with it
                content = identity(config)
                key = hash_of(content)
                name = cell_name(config.scene.name, row.name, seed, key)
                folder, log = results / "runs" / name, results / "logs" / f"{name.replace('/', '-')}.log"
                command = (*overrides_of(row, scene, seed), f"out={written(folder)}")
                config = replace(config, out=str(folder), command=command)
                cells.append(Cell(row.name, config.scene.name, seed, key, folder, log, config, content))
        except BrokenPlugin as error:
            if broken is None:
                raise
            broken(f"{row.name}: left out: {error}")
        except InputError as error:
            raise InputError(f"row {row.name!r}: {error}") from None
    if not cells:
        raise InputError(f"table {request.name}: expected at least one row and one scene, found none")
    first: dict[Path, Cell] = {}
    for cell in cells:
        if (other := first.setdefault(cell.folder, cell)) is not cell:  # of which a report would show one
            raise InputError(f"{cell.folder}: expected the folder of one run, found {other.name} and {cell.name}")
    return cells


@dataclass(frozen=True)
class CellList:
    """The cells of a table in their order, how many run at a time (None: as many as fit), and when it was started last."""

    table: str
    jobs: int | None
    cells: tuple[ListedCell, ...]
    started: float = 0.0


def write_cells(results: Path, table: str, jobs: int | None, cells: Sequence[Cell]) -> None:
    """Write down the cells of a table that is about to run in the folder ``results``."""
    listed = [{part.name: getattr(cell, part.name) for part in fields(ListedCell)} for cell in cells]
    content = {"table": table, "jobs": jobs, "cells": listed}
    text = json.dumps(content, indent=1, default=lambda path: path.relative_to(results).as_posix())
    results.mkdir(parents=True, exist_ok=True)
    with whole_file(results / CELLS) as partial:
        partial.write_text(text, encoding="utf-8")


def read_cells(results: Path) -> CellList:
    """What :func:`write_cells` wrote into ``results``. Raises InputError where it did not, and for anything else there."""
    path = results / CELLS
    if not path.exists():
        raise InputError(f"{results}: expected the results of a table, which has a {CELLS}, found none")
    found = parsed_file(CellList, path, read_json(path), "expected the cells of a table: ")
    cells = tuple(replace(cell, folder=results / cell.folder, log=results / cell.log) for cell in found.cells)
    return replace(found, cells=cells, started=path.stat().st_mtime)


def folders_with_cells(paths: Sequence[Path], note: Callable[[str], object]) -> dict[Path, tuple[str, str, int] | None]:
    """Every run folder below ``paths`` -> its row, scene and seed by the table that made it; None where no table lists any.

    Where a folder holds the cells of a table, its other runs are left out, and ``note`` is told how many: they are of rows, scenes,
    seeds or settings that were asked for before. A cell without a record has no label: it has not ended. Of a file beside folders,
    which a shell's ``*`` has named, ``note`` is told alone.

    Raises InputError for a path where nothing is, and for files without any folder.
    """
    roots = [path for path in paths if path.is_dir()]
    files = [path for path in paths if path.is_file()] if roots else []
    if wrong := [str(path) for path in paths if path not in (*roots, *files)]:
        raise InputError(f"{', '.join(wrong)}: expected a folder with runs, found none")
    for path in files:
        note(f"{path}: passed over, since it is a file and no folder with runs")
    found: dict[Path, tuple[str, str, int] | None] = dict.fromkeys(find_run_folders(*roots))
    for results in sorted({path.parent for root in roots for path in root.rglob(CELLS)}):
        try:
            cells = {cell.folder: cell.labels for cell in read_cells(results).cells}
        except InputError as error:
            note(f"{error}: passed over")
            continue
        others = [found.pop(folder) for folder in list(found) if folder.is_relative_to(results) and folder not in cells]
        if others:
            many = f"{len(others)} {'run is' if len(others) == 1 else 'runs are'}"
            note(
                f"{results}: {many} left out, since {CELLS} there, of the table's last call, does not list more; "
                f"the runs of all calls: {results / 'runs'}"
            )
        found |= {folder: cell for folder, cell in cells.items() if (folder / METRICS_FILE).is_file()}
    return found


@dataclass(frozen=True)
class CellStatus:
    """Where one cell stands.

    Attributes:
        cell: Which.
        state: RUNNING, WAITING, FAILED or FINISHED; a run that was begun and that nobody is at waits.
        seconds: That a finished one took in all, or that a running one has been at work; None where unknown.
        says: The last line of progress of a running one, or why one failed.
        written: When its record was written, in ns; 0 without one.
    """

    cell: ListedCell
    state: str
    seconds: float | None = None
    says: str = ""
    written: int = 0


@dataclass(frozen=True)
class Overview:
    """Where all cells of a table stand, and the plan that lists them."""

    plan: CellList
    cells: tuple[CellStatus, ...]

    def of(self, *states: str) -> list[CellStatus]:
        """The cells in one of ``states``."""
        return [one for one in self.cells if one.state in states]

    def seconds_left(self) -> float | None:
        """About how long the rest takes, once something has finished; None before.

        A cell is expected to take as long as the finished ones of its row, or as all of them where its row has none. Cells side
        by side are taken to share the rest evenly.
        """
        running, finished = self.of(RUNNING), [one for one in self.of(FINISHED) if one.seconds is not None]
        if not finished:
            return None

        def expected(cell: ListedCell) -> float:
            alike = [one for one in finished if one.cell.row == cell.row] or finished
            return fmean(one.seconds for one in alike if one.seconds is not None)

        begun = [max(0.0, expected(one.cell) - (one.seconds or 0.0)) for one in running]
        waiting = [expected(one.cell) for one in self.of(WAITING)]
        return max(sum((*begun, *waiting)) / max(1, self.plan.jobs or len(running)), *begun, 0.0)


def look(results: Path) -> Overview:
    """Where the cells of a table stand. Raises InputError for a folder that no table was run in."""
    plan = read_cells(results)
    return Overview(plan, tuple(_stands(cell, plan.started) for cell in plan.cells))


def _stands(cell: ListedCell, started: float) -> CellStatus:
    written, began = recorded_at(cell.folder), held_since(cell.folder)
    if began is not None:
        said = ""
        if is_file(cell.log):  # and no pipe, at which one would wait
            with suppress(OSError), cell.log.open("rb") as file:
                file.seek(max(0, cell.log.stat().st_size - TAIL_BYTES))
                said = "".join(PROGRESS.findall(file.read().decode(errors="replace"))[-1:]).strip()
        return CellStatus(cell, RUNNING, max(0.0, time.time() - began), said)
    record = _record(cell.folder, written)
    if isinstance(record, str):
        return CellStatus(cell, FAILED, says=record, written=written)
    if record is not None and record.config_hash == cell.config_hash:
        if record.status == "ok":
            return CellStatus(cell, FINISHED, record.time_s.get("total"), written=written)
        if written / 1e9 >= started:  # a failure of before will be tried again
            return CellStatus(cell, FAILED, says=record.error, written=written)
    return CellStatus(cell, WAITING)


@lru_cache(maxsize=100_000)  # every few seconds all of them are looked at, and few have been written since
def _record(folder: Path, written: int) -> RunRecord | str | None:
    """What a run has recorded; why it cannot be read; None where there is none yet."""
    try:
        return RunRecord.read(folder) if written else None
    except InputError as error:
        return str(error)
