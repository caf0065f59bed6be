"""The cells of a table until each is finished or has failed, on whatever machines its launcher finds."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.errors import Fault, InputError
from ia_bench.common.exit_codes import INTERRUPTED, OK, TERMINATED
from ia_bench.common.machine import commit
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import Cell
from ia_bench.runs.folder import RunFolder, held_since, recorded_at
from ia_bench.runs.identity import labels, setup
from ia_bench.runs.interruption import GRACE_SECONDS
from ia_bench.runs.launchers import ARRAY, Job, Local, WorkerDied
from ia_bench.runs.record import RunRecord, finished_record

ENDING_SECONDS = GRACE_SECONDS + 5
"""Runs that are cancelled have this time to save their state and end."""


def run_cells(cells: Sequence[Cell], launcher: Local, jobs: int, progress: Progress) -> int:
    """Run what is not finished, at most ``jobs`` at a time, and return how many cells failed.

    A cell whose worker dies is started again, ``launcher.attempts`` times in all, and goes on from its checkpoint. One that fails
    by itself would only fail again, and one whose record cannot be read has failed: it is left as it is.
    """
    finished: list[RunRecord] = []
    waiting: deque[Cell] = deque()
    failed = 0
    for cell in cells:
        try:
            record = finished_record(cell.folder, cell.config_hash)
        except InputError as error:
            progress.note(f"{cell.name}: FAILED ({error})")
            failed += 1
            continue
        if record is None:
            waiting.append(cell)
        else:
            finished.append(record)
    if finished:
        progress.note(f"{len(finished)} of {len(cells)} cells are finished already")
        here = commit()
        others = [record for record in finished if record.environment.get("commit") != here]
        if here is not None and others:
            progress.note(f"{len(others)} of them come from another state of the code; delete their folders to repeat them")
    if not waiting:
        return failed
    logs = waiting[0].log.parent
    logs.mkdir(parents=True, exist_ok=True)
    task = progress.task("table", total=len(cells), done=len(cells) - len(waiting), unit="cell")
    before = {cell.folder: recorded_at(cell.folder) for cell in waiting}
    for cell in waiting:
        if held_since(cell.folder) is None:  # by another table, whose run writes there
            cell.log.unlink(missing_ok=True)
    attempts: Counter[Path] = Counter()
    running: dict[Job, Cell] = {}
    with launcher.opened(logs) as start:
        try:
            while waiting or running:
                chosen = [waiting.popleft() for _ in range(min(len(waiting), jobs - len(running), ARRAY))]
                if chosen:  # of several, those that were started before one cannot be are among the running, which are ended
                    running.update(zip(start([(cell.config, cell.log) for cell in chosen]), chosen, strict=True))
                ended = [job for job in running if job.done()]
                for job in ended:
                    cell = running.pop(job)
                    attempts[cell.folder] += 1
                    made = attempts[cell.folder]
                    problem, died = _end_of(job, cell.log)
                    if died and made < launcher.attempts:
                        progress.note(f"{cell.name}: {problem}; attempt {made + 1} of {launcher.attempts}")
                        waiting.append(cell)
                        continue
                    if problem is not None:
                        failed += 1
                        problem += f"; {made} attempts" if made > 1 else ""
                        told = _failed(cell, problem, before[cell.folder])
                    progress.note(f"{cell.name}: {'ok' if problem is None else told}")
                    task.advance(1, failed=failed)
                if not ended:
                    time.sleep(launcher.poll_seconds)
        except BaseException:
            if running:
                progress.note(f"ending {len(running)} cells; they save their state first")
            for job in running:  # at work, or waiting on a cluster
                job.cancel()
            deadline = time.monotonic() + ENDING_SECONDS
            while not all(job.done() for job in running) and time.monotonic() < deadline:
                time.sleep(0.1)
            raise
    return failed


def _end_of(job: Job, log: Path) -> tuple[str | None, bool]:
    """What went wrong with an attempt in one line, or None; and whether its worker died, so that another may succeed."""
    try:
        status = job.result()
    except WorkerDied as death:
        return f"worker died: {death}", True
    if status == OK:
        return None, False
    if status < 0:
        return f"worker died: killed by signal {-status}", True
    lines = log.read_text(encoding="utf-8", errors="replace").strip().split("\n") if log.exists() else []
    return f"exit status {status}: {lines[-1].strip() if lines else 'no output'}", status in (INTERRUPTED, TERMINATED)


def _failed(cell: Cell, problem: str, before: int) -> str:
    """Record the failure, unless the run has (its record was written at ``before``); the cell's last word."""
    try:
        with RunFolder(cell.folder, cell.content, cell.config_hash, setup=setup(cell.config)) as folder:
            if recorded_at(cell.folder) == before:  # it could not say why, and nobody else has finished it since
                folder.write_failure(problem, labels(cell.config, cell.content))
    except (InputError, Fault, OSError) as error:  # of this cell; the others go on
        return f"FAILED ({error})"
    return f"FAILED ({problem}), see {cell.log}"
