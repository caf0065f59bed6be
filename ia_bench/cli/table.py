"""Every row x scene x seed of a table, each as a run of its own, then the report. table=paper is ours, after the paper's table 1.

    ia-bench table [table=paper] [rows=none,targets] [seeds=0,1] [scenes=hat,ship] [jobs=auto] [SETTING=VALUE ...]
    ia-bench table table=FILE.yaml ...
    ia-bench table launcher=ray|submitit_slurm|submitit_local [launcher.SETTING=VALUE ...] ...

A cell runs in a process of its own, so that one that crashes takes no other with it; it is started again from its last
checkpoint, launcher.attempts=3 times in all. Finished cells are skipped, failed ones are tried again, shown and counted.
All other overrides go to every cell, but none may set what a row sets itself. Everything is left in results/TABLE/; the
report there is of the rows, scenes and seeds that were asked for last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from textwrap import fill
from typing import Any

from ia_bench.common.arguments import read_arguments, settings_of
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import FAULT, OK, command, complain
from ia_bench.common.paths import conf_folder
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import TableRequest, make_cells, write_cells
from ia_bench.runs.composition import compose
from ia_bench.runs.config import RunConfig, slug
from ia_bench.runs.launchers import AS_MANY_AS_FIT, LAUNCHERS
from ia_bench.runs.schedule import run_cells
from ia_bench.runs.table import key_of, refuse_own

OWN = ("table", "rows", "scenes", "seeds", "jobs", "launcher")
"""What the command line says of the table itself; all else goes to every cell."""
SETTINGS = tuple(field.name for field in fields(RunConfig) if field.name != "command")


def parse(arguments: Sequence[str]) -> TableRequest:
    """Tell the table's own arguments from overrides. Raises InputError for a value that is no name or number."""
    own, overrides = [], []
    for argument in arguments:
        key, separator, _ = argument.partition("=")
        first = key.lstrip("+~").split(".")[0]
        if not separator:
            a_table = argument.endswith(".yaml") or (conf_folder() / "table" / f"{argument}.yaml").is_file()
            meant = f", such as table={argument}" if a_table else ""
            raise InputError(f"expected SETTING=VALUE{meant}, found '{argument}'; --help says more")
        if key in OWN or key.startswith("launcher."):
            own.append(argument)
        elif first in SETTINGS:
            refuse_own(argument)
            overrides.append(argument)
        else:
            raise InputError(unknown("setting", first, sorted((*OWN, *SETTINGS))))
    name = next((text.partition("=")[2] for text in reversed(own) if text.startswith("launcher=")), "local")
    if name not in LAUNCHERS:
        raise InputError(unknown("launcher", name, list(LAUNCHERS)))
    kind = LAUNCHERS[name]
    if kind.extra is not None and find_spec(kind.extra) is None:
        install = f"pip install 'ia_bench[{kind.extra}]', or -e '.[{kind.extra}]' in the checkout"
        raise InputError(f"launcher={name} needs an extra: {install}")
    request: Any = make_dataclass("Request", [("launcher", kind, field(default_factory=kind))], bases=(TableRequest,), frozen=True)
    own = [text for text in own if not text.startswith("launcher=") and text != "jobs=auto"]  # which is None
    found = TableRequest(**vars(read_arguments(request, own)))
    if getattr(found.launcher, "gpus", 0) and "device" not in map(key_of, overrides):
        overrides.append("device=cuda")
    return replace(found, overrides=tuple(overrides))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the table's command line and return its exit status: 1 if a cell failed, otherwise as ``ia_bench``."""
    return command(_usage, lambda given: make_table(parse(given)), arguments, resumes=True)


def make_table(request: TableRequest) -> int:
    """Run every cell, write the report, print the table and where the files are."""
    from ia_bench.cli.report import finish  # brings in pandas
    from ia_bench.report.table import counterparts
    from ia_bench.report.write import write_report

    table = request.load()
    try:
        counterparts(table.papers)
    except InputError as error:
        raise InputError(f"table {request.name}: {error}") from None
    launcher = request.launcher
    of_the_machine = [text for text in request.overrides if key_of(text) in ("device", "threads")]
    config = compose(of_the_machine, here=launcher.here)  # the others are composed with each row, which may be what knows them
    jobs, threads = launcher.jobs_and_threads(request.jobs, config.device)
    if config.threads is not None and "threads" in map(key_of, of_the_machine):
        threads = config.threads
    results = Path("results", slug(request.name))
    broken: list[str] = []
    cells = make_cells(table, request, threads, results, broken.append)
    with Progress() as progress:
        at_a_time = "as many at a time as fit" if jobs == AS_MANY_AS_FIT else f"{jobs} at a time"
        progress.note(f"{results}: {len(cells)} cells, {at_a_time}, {threads} thread{'s' * (threads > 1)} each")
        for line in broken:
            progress.note(line)
        known_as = str(Path(request.table).resolve()) if request.table.endswith(".yaml") else request.table
        write_cells(results, known_as, None if jobs == AS_MANY_AS_FIT else jobs, cells)
        progress.note(f"ia-bench watch {results}: the page of this table while it grows")
        failed = run_cells(cells, launcher, jobs, progress)
    ran = {cell.folder: cell.labels for cell in cells}
    shown = replace(table, scenes=list(dict.fromkeys(cell.scene for cell in cells)))
    finish(write_report(ran, results, shown), results, request.name)
    if failed:
        broken.append(f"{failed} of {len(cells)} cells failed; {results / 'logs'} says why")
    for line in broken:
        complain(line)
    return FAULT if broken else OK


def _usage() -> str:
    """The help, which ends with the settings of every launcher and their defaults."""
    lines = [f"{(__doc__ or '').rstrip()}\n\nSettings launcher.*, described in docs/clusters.md"]
    for name, kind in LAUNCHERS.items():
        shown = [f"{key}={'null' if value is None else value}" for key, value in settings_of(kind)]
        lines.append(fill(" ".join(shown), 118, initial_indent=f"  {name:<16}", subsequent_indent=" " * 18))
    return "\n".join(lines)
