"""``python -m ia_bench.cli.report RUNS... --out FOLDER``: the report of runs that are there already; nothing is run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, status_of
from ia_bench.common.output import say
from ia_bench.common.paths import make_writable
from ia_bench.report.collect import find_run_folders
from ia_bench.report.texts import markdown_block
from ia_bench.report.write import Report, write_report
from ia_bench.runs.table import Table, load_table


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m ia_bench.cli.report", description=__doc__, allow_abbrev=False)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUNS", help="folders that are searched for run folders")
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    parser.add_argument("--table", help="a table of conf/table: order of rows and scenes, reference, claims")
    parser.add_argument("--reference", help="the row that the others are compared with (default: the table's)")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _report(wanted))


def _report(wanted: argparse.Namespace) -> int:
    for folder in wanted.runs:
        if not folder.is_dir():
            raise InputError(f"{folder}: expected a folder with runs, found none")
    table = load_table(wanted.table) if wanted.table else Table()
    make_writable(wanted.out, "--out")
    try:
        report = write_report(
            find_run_folders(*wanted.runs),
            wanted.out,
            [row.name for row in table.rows],
            scenes_order=table.scenes,
            reference=wanted.reference or table.reference,
            claims=table.claims,
            papers=table.papers,
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    tell(report, table)
    return OK


def tell(report: Report, table: Table) -> None:
    """Print the means over scenes, what a reader has to know of the rows, and where the files are."""
    findings = report.findings
    lines = [
        f"Protocol {findings.protocol}, mean over scenes\n",
        markdown_block(findings.overall, findings.footnotes),
        *(f"[^{number}]: {reason}" for reason, number in findings.footnotes.items()),
        *(f"{row.name}: {row.note}" for row in table.rows if row.note),
        "",
        *map(str, report.files),
    ]
    say("\n".join(lines), sys.stdout)


if __name__ == "__main__":
    raise SystemExit(main())
