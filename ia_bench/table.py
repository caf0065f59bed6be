"""``python -m ia_bench.table``: every row x scene x seed of a table, each as a run of its own, then the report.

    python -m ia_bench.table [table=paper] [seeds=0,1] [scenes=hat,ship] [jobs=auto] [SETTING=VALUE ...]

A cell runs in a process of its own, so that one that crashes takes no other with it. Finished cells are skipped, failed
ones are tried again, shown and counted. All other overrides go to every cell. Everything is left in results/<table>/.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from ia_bench.__main__ import FAULT, INTERRUPTED, MISTAKE, OK
from ia_bench.composition import compose
from ia_bench.config import NATIVE_READER, RunConfig, hash_of, identity, labels, resolve_scene_folder, slug
from ia_bench.environment import commit, total_memory
from ia_bench.errors import InputError
from ia_bench.paths import conf_folder
from ia_bench.progress import Progress
from ia_bench.records import METRICS, RunFolder, finished_metrics
from ia_bench.report.columns import METRIC_OF, Claim
from ia_bench.suggest import unknown

MEMORY_PER_JOB = 3 << 30
"""Bytes that one job may need at the default preset; ``jobs=auto`` starts no more jobs than fit."""


@dataclass
class Row:
    """A row of the table: the overrides that make it, what a reader has to know of it, its seeds if not the table's."""

    name: str
    overrides: list[str]
    note: str = ""
    seeds: list[int] | None = None


@dataclass
class Table:
    """``conf/table/<name>.yaml``; ``reference`` names the row that the others are compared with, scene by scene.

    ``claims``: orderings of rows that the report judges. ``pictured``: rows that one picture per scene shows beside the truth.
    """

    scenes: list[str] = field(default_factory=list)
    seeds: list[int] = field(default_factory=lambda: [0])
    rows: list[Row] = field(default_factory=list)
    reference: str | None = None
    claims: list[Claim] = field(default_factory=list)
    pictured: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Request:
    """The command line: which table, what replaces its scenes and seeds, how many jobs, overrides for every cell."""

    table: str = "paper"
    scenes: tuple[str, ...] | None = None
    seeds: tuple[int, ...] | None = None
    jobs: int | None = None
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cell:
    """One run of the table: what it computes, the command line that does, and where its results go."""

    row: Row
    config: RunConfig
    content: dict[str, Any]
    overrides: tuple[str, ...]

    @property
    def config_hash(self) -> str:
        """Identity of the run."""
        return hash_of(self.content)

    @property
    def folder(self) -> Path:
        """The run's folder."""
        assert self.config.out is not None
        return Path(self.config.out)

    @property
    def name(self) -> str:
        """How messages call this cell."""
        return f"{self.config.scene.name} / {self.row.name} / seed {self.config.seed}"


def parse(arguments: Sequence[str]) -> Request:
    """Tell the table's own arguments from overrides. Raises InputError for a value that is no name or number."""
    own: dict[str, Any] = {}
    overrides = []
    for argument in arguments:
        key, separator, value = argument.partition("=")
        if not separator:
            raise InputError(f"expected SETTING=VALUE, found '{argument}'; --help says more")
        if key == "table":
            own[key] = value
        elif key == "scenes":
            own[key] = tuple(value.split(","))
        elif key == "seeds":
            own[key] = tuple(_whole(key, number, 0) for number in value.split(","))
        elif key == "jobs":
            own[key] = None if value == "auto" else _whole(key, value, 1)
        elif key.lstrip("+~") in ("scene", "scene.name", "scene.path", "seed", "row", "out"):
            raise InputError(f"{key}={value}: the table sets this for every cell; it has scenes=, seeds= and table=")
        else:
            overrides.append(argument)
    return Request(**own, overrides=tuple(overrides))


def load_table(name: str) -> Table:
    """Read ``conf/table/<name>.yaml``. Raises InputError naming the closest table, or the file and key at fault."""
    path = conf_folder() / "table" / f"{name}.yaml"
    if not path.is_file():
        raise InputError(unknown("table", name, sorted(p.stem for p in path.parent.glob("*.yaml"))))
    try:
        table = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(Table), OmegaConf.load(path)))
    except (OmegaConfBaseException, YAMLError) as error:
        raise InputError(f"{path}: {error}") from None
    assert isinstance(table, Table)
    names = [row.name for row in table.rows]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: rows: expected different names, found {', '.join(names)}")
    for where, seeds in (("seeds", table.seeds), *((f"rows: {row.name}: seeds", row.seeds) for row in table.rows)):
        if seeds is not None and not seeds:
            raise InputError(f"{path}: {where}: expected at least one, found none")
    if table.reference is not None and table.reference not in names:
        raise InputError(f"{path}: reference: {unknown('row', table.reference, names)}")
    for row in table.pictured:
        if row not in names:
            raise InputError(f"{path}: pictured: {unknown('row', row, names)}")
    for claim in table.claims:
        for key, found, known in (
            *(("row", row, names) for row in (claim.better, claim.worse)),
            *(("metric", metric, list(METRIC_OF)) for metric in claim.metrics),
        ):
            if found not in known:
                raise InputError(f"{path}: claims: {unknown(key, found, known)}")
    return table


def make_cells(table: Table, request: Request, threads: int, results: Path) -> list[Cell]:
    """Every row x scene x seed, composed and checked; row after row, so that jobs side by side differ in scene.

    The request's seeds replace the table's, not those of a row that has its own. Raises InputError where there
    is no cell, or one twice.
    """
    seeds = table.seeds if request.seeds is None else request.seeds
    cells = [
        _cell(row, scene, seed, request, threads, results)
        for row in table.rows
        for seed in (seeds if row.seeds is None else row.seeds)
        for scene in (request.scenes if request.scenes is not None else table.scenes)
    ]
    if not cells:
        raise InputError(f"table {request.table}: expected at least one row and one scene, found none")
    twice = [name for name, count in Counter(cell.name for cell in cells).items() if count > 1]
    if twice:
        raise InputError(f"expected every row, scene and seed once, found {twice[0]} more than once")
    return cells


def jobs_and_threads(jobs: int | None, device: str) -> tuple[int, int]:
    """How many cells run side by side, and on how many threads each.

    Depends on the machine alone, never on what is left to do: threads are part of a run's identity, and a table that is
    resumed or extended has to find its finished cells again. One GPU does one cell at a time.
    """
    cores = len(os.sched_getaffinity(0))
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the table's command line and return its exit status: 1 if a cell failed, otherwise as ``ia_bench``."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(__doc__, end="")
        return OK
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return make_table(parse(arguments))
    except InputError as error:
        if os.environ.get("IA_BENCH_DEBUG") == "1":
            raise
        print(f"ia_bench.table: {error}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("ia_bench.table: interrupted; the same command resumes", file=sys.stderr)
        return INTERRUPTED


def make_table(request: Request) -> int:
    """Run every cell, write the report, print the table and where the files are."""
    from ia_bench.report.markdown import markdown_block  # these bring in matplotlib
    from ia_bench.report.write import write_report

    table = load_table(request.table)
    base = compose(request.overrides)  # a mistake in what goes to every cell is best told before the first
    jobs, threads = jobs_and_threads(request.jobs, base.device)
    results = Path("results", slug(request.table))
    cells = make_cells(table, request, threads, results)
    with Progress() as progress:
        progress.note(f"{results}: {len(cells)} cells, {jobs} at a time, {threads} threads each")
        failed = run_cells(cells, jobs, results / "logs", progress)
    report = write_report(
        {cell.folder: (cell.row.name, cell.config.scene.name, cell.config.seed) for cell in cells},
        results,
        [row.name for row in table.rows],
        scenes_order=list(dict.fromkeys(cell.config.scene.name for cell in cells)),
        reference=table.reference,
        claims=table.claims,
    )
    print(f"Protocol {report.findings.results.protocol}, mean over scenes\n")
    print(markdown_block(report.findings.results.overall))
    print("\n".join(f"{row.name}: {row.note}" for row in table.rows if row.note))
    print("\n" + "\n".join(str(path) for path in (*report.files, *_write_pictures(table.pictured, cells, results))))
    if failed:
        print(f"{failed} of {len(cells)} cells failed; {results / 'logs'} says why", file=sys.stderr)
    return FAULT if failed else OK


def _write_pictures(rows: Sequence[str], cells: Sequence[Cell], results: Path) -> list[Path]:
    """One picture per scene of the first finished cell of each of ``rows``; what has none is left out, as are scene plugins.

    A scene that cannot be pictured (no novel light, say) is named on stderr: the table is finished without it.
    """
    from ia_bench.report.comparison import write_comparison  # brings in torch

    finished: dict[tuple[str, str], Cell] = {}
    for cell in cells:
        if finished_metrics(cell.folder, cell.config_hash) is not None and cell.config.scene.reader == NATIVE_READER:
            finished.setdefault((cell.config.scene.name, cell.row.name), cell)
    written = []
    for scene in dict.fromkeys(cell.config.scene.name for cell in cells):
        shown = {row: finished[scene, row] for row in rows if (scene, row) in finished}
        if shown:
            folder = resolve_scene_folder(next(iter(shown.values())).config.scene)
            assert folder is not None
            picture = results / "pictures" / f"{slug(scene)}.png"
            try:
                write_comparison({row: cell.folder for row, cell in shown.items()}, folder, picture)
            except InputError as error:
                print(f"ia_bench.table: no picture of {scene}: {error}", file=sys.stderr)
            else:
                written.append(picture)
    return written


def _cell(row: Row, scene: str, seed: int, request: Request, threads: int, results: Path) -> Cell:
    own = [f"scene={scene}", f"seed={seed}", f"threads={threads}", f"row={_quoted(row.name)}"]
    overrides = [*row.overrides, *own, *request.overrides]
    config = compose(overrides)
    content = identity(config)
    folder = results / "runs" / slug(scene) / f"{slug(row.name)}-seed{seed}-{hash_of(content)[:8]}"
    overrides.append(f"out={_quoted(str(folder))}")
    return Cell(row, replace(config, out=str(folder)), content, tuple(overrides))


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


def _quoted(text: str) -> str:
    """A text as a value in Hydra's grammar, whatever characters it has."""
    return "'" + text.replace("'", "\\'") + "'"


def _whole(key: str, text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise InputError(f"{key}={text}: expected whole numbers from {least}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
