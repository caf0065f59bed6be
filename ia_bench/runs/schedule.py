"""The cells of a table, run side by side: each in a process of its own, so that one that crashes takes no other with it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from threading import Event
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK
from ia_bench.common.machine import commit, total_memory
from ia_bench.common.progress import Progress
from ia_bench.runs.config import labels, slug
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.metrics import METRICS, finished_metrics
from ia_bench.runs.table import Cell

MEMORY_PER_JOB = 3 << 30
"""Bytes that one job may need at the default preset; ``jobs=auto`` starts no more jobs than fit."""


def jobs_and_threads(jobs: int | None, device: str) -> tuple[int, int]:
    """How many cells run side by side, and on how many threads each.

    Depends on the machine alone, never on what is left to do: threads are part of a run's identity, and a table that is
    resumed or extended has to find its finished cells again. One GPU does one cell at a time. Raises InputError for more jobs
    than cores.
    """
    cores = len(os.sched_getaffinity(0))
    if jobs is not None and jobs > cores:
        raise InputError(f"jobs={jobs}: expected at most {cores}, the cores that this process may use")
    if jobs is None:
        jobs = 1 if device == "cuda" else max(1, min(cores, total_memory() // MEMORY_PER_JOB))
    return jobs, max(1, cores // jobs)


def run_cells(cells: Sequence[Cell], jobs: int, logs: Path, progress: Progress) -> int:
    """Run what is not finished, ``jobs`` at a time, and return how many cells failed."""
    finished = {cell.name: finished_metrics(cell.folder, cell.config_hash) for cell in cells}
    missing = [cell for cell in cells if finished[cell.name] is None]
    if len(missing) < len(cells):
        progress.note(f"{len(cells) - len(missing)} of {len(cells)} cells are finished already")
        _note_other_commits([metrics for metrics in finished.values() if metrics], progress)
    logs.mkdir(parents=True, exist_ok=True)
    task = progress.task("table", total=len(cells), done=len(cells) - len(missing))
    failed = 0
    running: set[subprocess.Popen[bytes]] = set()
    stopping = Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            futures = {pool.submit(_run_cell, cell, logs, running, stopping): cell for cell in missing}
            for future in as_completed(futures):
                problem = future.result()
                failed += problem is not None
                progress.note(f"{futures[future].name}: {problem or 'ok'}")
                task.advance(1, failed=failed)
        except BaseException:
            stopping.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list(running):
                process.terminate()  # each resumes from its last checkpoint
            raise
    return failed


def _run_cell(cell: Cell, logs: Path, running: set[subprocess.Popen[bytes]], stopping: Event) -> str | None:
    """Run one cell in a process of its own; what went wrong in one line, or None. ``stopping``: the table is being interrupted."""
    log = logs / f"{slug(cell.config.scene.name)}-{cell.folder.name}.log"
    before = _time_of_record(cell)
    command = [sys.executable, "-m", "ia_bench", *cell.overrides]
    try:
        with log.open("wb") as output:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)
            running.add(process)
            if stopping.is_set():  # it started while the others were being terminated
                process.terminate()
            status = process.wait()
            running.discard(process)
        if status == OK:
            return None
        if stopping.is_set():  # it did not fail: the same command resumes it
            return "interrupted"
        lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "no output")
        how = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        with RunFolder.open(cell.folder, cell.content, cell.config_hash) as folder:
            if _time_of_record(cell) == before:  # it ended before it could say why, and nobody else has finished it since
                folder.write_failure(f"{how}: {last}", labels(cell.config))
    except (InputError, OSError) as error:  # of this cell; the others go on
        return f"FAILED ({error})"
    return f"FAILED ({how}: {last}), see {log}"


def _time_of_record(cell: Cell) -> int | None:
    """When the cell's metrics were written, in ns; None if they never were."""
    record = cell.folder / METRICS
    return record.stat().st_mtime_ns if record.exists() else None


def _note_other_commits(finished: Sequence[dict[str, Any]], progress: Progress) -> None:
    here = commit()
    others = [metrics for metrics in finished if metrics["environment"].get("commit") != here]
    if here is not None and others:
        progress.note(f"{len(others)} of them come from another state of the code; delete their folders to repeat them")
