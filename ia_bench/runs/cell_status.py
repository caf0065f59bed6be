"""How far the runs of a folder are: which run, wait, finished, failed. Only read from files; nothing is asked of the runs."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from statistics import fmean

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.runs.cells import CellList, Planned, read_cells
from ia_bench.runs.config import RunConfig
from ia_bench.runs.folder import find_run_folders, held_since
from ia_bench.runs.record import METRICS_FILE, RunRecord, RunSetup

RUNNING, WAITING, FAILED, FINISHED = "running", "waiting", "failed", "finished"
PROGRESS = re.compile(r"^(.+: \d+/\d+, .*)$", re.MULTILINE)  # as common.progress writes it where nobody draws bars
TAIL_BYTES = 4096  # of a log, in which the last line of progress is looked for


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

    cell: Planned
    state: str
    seconds: float | None = None
    says: str = ""
    written: int = 0


@dataclass(frozen=True)
class Overview:
    """Where all cells of a folder stand, and the plan that lists them, None where no table was run there."""

    plan: CellList | None
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

        def expected(cell: Planned) -> float:
            alike = [one for one in finished if one.cell.row == cell.row] or finished
            return fmean(one.seconds for one in alike if one.seconds is not None)

        begun = [max(0.0, expected(one.cell) - (one.seconds or 0.0)) for one in running]
        waiting = [expected(one.cell) for one in self.of(WAITING)]
        side_by_side = self.plan.jobs if self.plan is not None and self.plan.jobs is not None else len(running)
        return max(sum((*begun, *waiting)) / max(1, side_by_side), *begun, 0.0)


def look(results: Path) -> Overview:
    """Where the cells of a table stand, or every run folder below ``results`` where no table has listed its cells.

    Raises InputError where there is neither.
    """
    plan = read_cells(results)
    if plan is not None:
        return Overview(plan, tuple(_stands(cell, plan.started) for cell in plan.cells))
    cells = tuple(_stands(cell, 0.0) for cell in _found(find_run_folders(results)))
    if not cells:
        raise InputError(f"{results}: expected the results of a table, or a folder with runs, found none")
    return Overview(None, cells)


def _stands(cell: Planned, started: float) -> CellStatus:
    written = _time_of(cell.folder / METRICS_FILE)
    record = _record(cell.folder, written)
    began = held_since(cell.folder)
    if began is not None:
        return CellStatus(cell, RUNNING, max(0.0, time.time() - began), _last_progress(cell.log))
    if record is None or (cell.config_hash and record.config_hash != cell.config_hash):
        return CellStatus(cell, WAITING)
    if record.status == "ok":
        return CellStatus(cell, FINISHED, record.time_s.get("total"), written=written)
    if record.status == "failed" and written / 1e9 >= started:  # one of before will be tried again
        return CellStatus(cell, FAILED, says=record.error, written=written)
    return CellStatus(cell, WAITING)


@lru_cache(maxsize=100_000)  # every few seconds all of them are looked at, and few have been written since
def _record(folder: Path, written: int) -> RunRecord | None:
    """What a run has recorded; None where it has not, or what lies there is no record."""
    try:
        return RunRecord.read(folder) if written else None
    except (InputError, FileNotFoundError):
        return None


def _found(folders: Sequence[Path]) -> Iterable[Planned]:
    """Run folders as cells; what one that has no record yet is called stands in its configuration."""
    for folder in folders:
        record = _record(folder, _time_of(folder / METRICS_FILE))
        with suppress(InputError):  # a folder without both files is another program's
            if record is not None:
                yield Planned(record.row, record.scene, record.seed, "", folder, folder / "log")
            else:
                config = parsed(RunConfig, RunSetup.read(folder).config)
                yield Planned(config.row_name, config.scene.name, config.seed, "", folder, folder / "log")


def _time_of(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _last_progress(log: Path) -> str:
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - TAIL_BYTES))
            found: list[str] = PROGRESS.findall(file.read().decode(errors="replace"))
    except OSError:
        return ""
    return found[-1].strip() if found else ""
