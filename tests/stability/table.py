"""Run every extreme case, print one line for each, write them to a file, and fail when one does.

    python -m ia_bench.stability [--out stability.json] [--only WORD]

Columns: what is extreme, what is computed, finite or not, error against the reference and how much is allowed, the
gradient's likewise, how often a guard (clamp, cut, refusal) was taken where that is counted, and the verdict.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from stability import extreme_lights, extreme_materials, extreme_priors, extreme_rendering, extreme_scores
from stability.case import Case, Row, judge

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.exit_codes import OK, complain

FAILED = 1


def all_cases() -> Iterator[Case]:
    """Every case of every group."""
    for part in (extreme_materials, extreme_lights, extreme_rendering, extreme_priors, extreme_scores):
        yield from part.cases()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print, write; the exit status is 1 when a case failed."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        prog="python -m ia_bench.stability", description=about, epilog=more, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="JSON file to write (its folder must exist)")
    parser.add_argument("--only", metavar="WORD", help="only cases whose group, extreme or quantity contains this")
    options = parser.parse_args(arguments)
    if options.out and not options.out.resolve().parent.is_dir():
        return complain(f"--out: {options.out.parent}: expected a folder, found none")
    wanted = [case for case in all_cases() if not options.only or options.only in f"{case.group} {case.extreme} {case.quantity}"]
    if not wanted:
        return complain(f"--only: no case contains {options.only!r}")
    rows = [judge(case) for case in wanted]
    print_rows(rows)
    if options.out:
        with whole_file(options.out) as partial:
            partial.write_text(json.dumps([record(row) for row in rows], indent=1) + "\n")
    failed = sum(row.problem is not None for row in rows)
    print(f"{len(rows)} cases, {failed} failed")
    return FAILED if failed else OK


def print_rows(rows: list[Row]) -> None:
    """One line each; as wide as it takes where the output is no terminal."""
    table = Table(box=None, pad_edge=False)
    for name in ("group", "extreme", "quantity", "reference", "finite", "error", "allowed", "gradient error", "guards", "verdict"):
        table.add_column(name, justify="right" if name in ("error", "allowed", "gradient error", "guards") else "left")
    for row in rows:
        case, m, numbers = row.case, row.measured, ["", "", f"{row.case.tolerance:g}", "", ""]
        if m is not None:
            gradient = "" if m.gradient_error is None else f"{m.gradient_error:.1e}"
            guards = "" if m.guards is None else str(m.guards)
            numbers = ["yes" if m.finite else "NO", f"{m.error:.1e}", f"{case.tolerance:g}", gradient, guards]
        verdict = "ok" if row.problem is None else f"FAILED: {row.problem}"
        table.add_row(case.group, case.extreme, case.quantity, case.reference, *numbers, verdict)
    Console(width=None if sys.stdout.isatty() else 240).print(table)


def record(row: Row) -> dict[str, Any]:
    """A row as JSON values; what is not finite is written as text."""
    of_case = "group", "extreme", "quantity", "reference", "tolerance", "gradient_tolerance"
    said = {name: getattr(row.case, name) for name in of_case}
    said |= {name: getattr(row.measured, name, None) for name in ("finite", "error", "gradient_error", "guards")}
    shown = {name: str(value) if isinstance(value, float) and not math.isfinite(value) else value for name, value in said.items()}
    return shown | {"verdict": "failed" if row.problem else "ok", "problem": row.problem}
