"""``python -m ia_bench.table``: every row x scene x seed of a table, each as a run of its own, then the report.

    python -m ia_bench.table [table=paper] [seeds=0,1] [scenes=hat,ship] [jobs=auto] [SETTING=VALUE ...]

A cell runs in a process of its own, so that one that crashes takes no other with it. Finished cells are skipped, failed
ones are tried again, shown and counted. All other overrides go to every cell. Everything is left in results/<table>/.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain, status_of
from ia_bench.common.output import say
from ia_bench.common.progress import Progress
from ia_bench.runs.composition import compose
from ia_bench.runs.config import resolve_scene_folder, slug
from ia_bench.runs.metrics import finished_metrics
from ia_bench.runs.schedule import jobs_and_threads, run_cells
from ia_bench.runs.table import Cell, Request, load_table, make_cells


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the table's command line and return its exit status: 1 if a cell failed, otherwise as ``ia_bench``."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not {"-h", "--help"}.isdisjoint(arguments):
        say(__doc__.rstrip(), sys.stdout)
        return OK
    return status_of(lambda: make_table(parse(arguments)))


def make_table(request: Request) -> int:
    """Run every cell, write the report, print the table and where the files are."""
    from ia_bench.cli.report import tell  # brings in pandas
    from ia_bench.report.write import write_report

    table = load_table(request.table)
    jobs, threads = jobs_and_threads(request.jobs, compose(request.overrides).device)
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
    tell(report, table)
    say("\n".join(map(str, _write_pictures(table.pictured, cells, results))), sys.stdout)
    return complain(f"{failed} of {len(cells)} cells failed; {results / 'logs'} says why", FAULT) if failed else OK


def _write_pictures(rows: Sequence[str], cells: Sequence[Cell], results: Path) -> list[Path]:
    """One picture per scene of the first finished cell of each of ``rows``; what has none is left out, as are scenes of no folder.

    A scene that cannot be pictured (no novel light, say) is named on stderr: the table is finished without it.
    """
    from ia_bench.report.comparison import write_comparison  # brings in torch

    finished: dict[tuple[str, str], Cell] = {}
    for cell in cells:
        if finished_metrics(cell.folder, cell.config_hash) is not None:
            finished.setdefault((cell.config.scene.name, cell.row.name), cell)
    written = []
    for scene in dict.fromkeys(cell.config.scene.name for cell in cells):
        shown = {row: finished[scene, row] for row in rows if (scene, row) in finished}
        config = next(iter(shown.values())).config if shown else None
        folder = resolve_scene_folder(config.scene, config.reader) if config is not None else None
        if folder is not None:
            picture = results / "pictures" / f"{slug(scene)}.png"
            try:
                write_comparison({row: cell.folder for row, cell in shown.items()}, folder, picture)
            except InputError as error:
                complain(f"no picture of {scene}: {error}")
            else:
                written.append(picture)
    return written


def _whole(key: str, text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise InputError(f"{key}={text}: expected whole numbers from {least}")
    return int(text)
