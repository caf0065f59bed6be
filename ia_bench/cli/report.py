"""``ia-bench report RUNS...``: the report of runs that are there already; nothing is run."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from ia_bench.common.arguments import Parser
from ia_bench.common.errors import InputError, listed, printable, unknown
from ia_bench.common.exit_codes import OK, complain, exits, say
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.report.collect import read_published
from ia_bench.report.site.page import PARTS, draw_pictures, write_page
from ia_bench.report.table import MAIN, OUR_TABLE, Entry, left_out, measured, results_table
from ia_bench.report.value import write_value
from ia_bench.report.write import Report, pipe_table, write_report
from ia_bench.runs.cells import CELLS, folders_with_cells, read_cells
from ia_bench.runs.table import Table, capture_of, crossed_name, load_table, some_rows

PAGE = "page"
"""The folder below a report's that holds its page."""
NOTES = 5  # so many of a report's notes are printed as well


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = Parser(prog="ia-bench report", description=__doc__.partition(": ")[2])
    what = "folders that are searched for run folders, or a former report's runs.csv"
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUNS", help=what)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="folder to write into (default: RUNS-report, beside RUNS)")
    parser.add_argument("--open", action="store_true", help="show the page in a browser")
    parser.add_argument("--table", help="a table: order of rows, reference, claims (default: that of its results)")
    parser.add_argument("--only", action="store_true", help="of every runs.csv, take the rows of --table alone")
    parser.add_argument("--reference", help="the row that the others are compared with (default: the table's)")
    wanted = parser.parse_args(arguments)
    tables = [path for path in wanted.runs if path.suffix == ".csv"]
    folders = [path for path in wanted.runs if path not in tables]
    cells = folders_with_cells(folders, complain)
    if wanted.only and not wanted.table:
        raise InputError("--only: expected --table NAME beside it, found none")
    table = _compared_with(load_table(wanted.table) if wanted.table else _table_of(folders), wanted.reference)
    rows = [row.name for row in table.crossed_rows]
    every = [run for path in tables for run in read_published(path)]
    published = [run for run in every if not wanted.only or run["row"] in rows]
    if every and not published and not cells:
        found = listed(dict.fromkeys(run["row"] for run in every))
        raise InputError(f"--only: expected runs of a row of table {wanted.table} ({listed(rows)}), found {found}")
    first = wanted.runs[0] if wanted.runs[0].name not in ("", "..") else wanted.runs[0].resolve()
    if not (wanted.out or first.name):
        raise InputError(f"--out: expected a folder, since {first} has no name that another could have, found none")
    out = wanted.out or first.with_name(f"{first.stem if wanted.runs[0] in tables else first.name}-report")
    make_writable(out, "--out")
    report = write_report(cells, out, table, published)
    page = finish(report, out, wanted.table or (out.resolve().name if wanted.out else first.name))
    if wanted.open and not webbrowser.open(page.resolve().as_uri()):
        say(f"no browser was found here; open {page} in one", sys.stdout)
    return OK


def _table_of(folders: Sequence[Path]) -> Table:
    """The table whose results one of the ``folders`` is, with the rows and scenes of its last call; else one without rows."""
    plans = [read_cells(folder) for folder in folders if (folder / CELLS).exists()]
    if len(plans) == 1:
        called, cells = plans[0].table, plans[0].cells
        listed = {cell.row for cell in cells}
        with suppress(InputError):  # its file may be gone, or another one now
            table = load_table(called)
            rows = [row.name for row in table.rows if any(one.name in listed for one in replace(table, rows=[row]).crossed_rows)]
            if rows:
                say(f"reported as table {called}; --table takes another", sys.stderr)
                return replace(some_rows(table, rows), scenes=[*dict.fromkeys(cell.scene for cell in cells)])
    return Table()


def _compared_with(table: Table, wanted: str | None) -> Table:
    """The table with the ``wanted`` row as its reference.

    Where it photographs its scenes in several ways, a row that is named with its capture stands for that row in each capture, and
    InputError is raised for what is no row of the table.
    """
    if wanted is not None and table.captures:
        labels = ["", *(capture_of(settings).label for settings in table.captures)]
        known = {crossed_name(row.name, label): row.name for row in table.rows for label in labels}
        if wanted not in known:
            raise InputError(f"--reference: {unknown('row', wanted, [row.name for row in table.rows])}")
        wanted = known[wanted]
    return table if wanted in (None, table.reference) else replace(table, reference=wanted, curve=[])  # more work of the former one


def finish(report: Report, out: Path, name: str) -> Path:
    """Write a report's page below ``out`` and what a prior is worth beside it; print means and files. Returns the page."""
    findings = report.findings
    with Progress() as progress:
        gallery = draw_pictures(findings.runs, out / PAGE / PARTS, progress.note)
    page = write_page(findings, f"Table: {name}", out / PAGE, gallery)
    main_table = results_table(findings.overall, findings.footnotes, measured(findings.overall, MAIN), {})
    marked = {number for cells in main_table.body for cell in cells if isinstance(cell, Entry) for number in cell.notes}
    lines = [
        *findings.warnings,
        *findings.notes[:NOTES],
        *([f"report.md has more notes: {len(findings.notes)} in all."] if len(findings.notes) > NOTES else []),
        f"Protocol {findings.protocol}, mean over scenes. {findings.made_alike}\n",
        *([OUR_TABLE.replace("\n", " "), ""] if findings.counterparts else []),
        pipe_table(main_table),
        *(f"[^{number}]: {reason}" for reason, number in findings.footnotes.items() if number in marked),
        *(f"Left out, for no run has it: {line}." for line in left_out(findings.overall)),
        *([findings.timing.told, pipe_table(findings.timed)] if findings.timing and findings.timed else []),
        *(f"{row.name}: {printable(row.note)}" for row in findings.table.crossed_rows if row.note),
        "",
        *map(str, report.files),
        f"{page} opens in a browser",
        *map(str, write_value(findings, out)),
    ]
    say("\n".join(lines), sys.stdout)
    return page
