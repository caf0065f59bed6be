"""The report as Markdown, LaTeX and CSV, files that hold it, and what a former report has left beside them.

The templates beside this file are filled from :class:`Findings`. Their marks are ``<< value >>``, ``<% statement %>`` and
``<# comment #>``: braces belong to LaTeX.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from ia_bench.common.atomic_file import whole_file
from ia_bench.report import table
from ia_bench.report.findings import Findings
from ia_bench.report.statistics import HOW_JUDGED, tally
from ia_bench.report.table import Entry, Printed
from ia_bench.scores.columns import METRICS

TITLE = "# Results\n"
"""How the template report.md begins."""
DIGITS = 7
"""Significant digits of what was computed from runs; those themselves are written as they are."""
LATEX = {letter: f"\\{letter}" for letter in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "†": r"$^\dagger$",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
}


def report_text(findings: Findings, pictures: Sequence[str]) -> str:
    """The report to read. ``pictures`` are the figures' paths relative to it."""
    return _filled("report.md", findings, pictures=pictures, how_judged=HOW_JUDGED, tally=tally)


def latex(findings: Findings) -> str:
    """The tables in the layout of the paper's table 1. The document needs the packages booktabs and graphicx."""
    groups = [(name, len(list(metrics))) for name, metrics in groupby(METRICS, key=lambda metric: metric.group)]
    return _filled("table.tex", findings, groups=groups, metrics=METRICS, columns=1 + len(METRICS) + len(table.COSTS))


def pipe_table(one: Printed) -> str:
    """A Markdown table, first column to the left, the others to the right."""
    rule = [":---", *["---:"] * (len(one.header) - 1)]
    lines = [list(map(markdown, one.header)), rule, *([markdown(cell) for cell in cells] for cells in one.body)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def markdown(cell: Entry | str) -> str:
    """An entry with its names kept from being read as markup."""
    cell = Entry(cell) if isinstance(cell, str) else cell
    text = "".join(f"\\{letter}" if letter in "\\`*_|[]<>" else letter for letter in cell.text)
    return (f"**{text}**" if cell.best else text) + "".join(f"[^{number}]" for number in cell.notes)


def tex(cell: Entry | str) -> str:
    """An entry with its special characters kept from being read as commands."""
    cell = Entry(cell) if isinstance(cell, str) else cell
    text = "".join(LATEX.get(letter, letter) for letter in cell.text.replace(" †", "†")).replace(r" $\pm$ ", r"\,$\pm$\,")
    notes = f"$^{{{','.join(map(str, cell.notes))}}}$" if cell.notes else ""
    return (rf"\textbf{{{text}}}" if cell.best else text) + notes


def _filled(template: str, findings: Findings, **more: object) -> str:
    environment = Environment(
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        loader=PackageLoader("ia_bench.report"),
        autoescape=False,  # not HTML: names are escaped by the two filters
    )
    environment.filters.update(markdown=markdown, pipe=pipe_table, tex=tex)
    results = partial(table.results_table, notes=findings.footnotes)
    return environment.get_template(f"{template}.j2").render(findings=findings, table=table, results=results, **more)


def write_text(path: Path, text: str) -> Path:
    """Write a file at once or not at all, and return its path; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial_:
        partial_.write_text(text, encoding="utf-8")
    return path


def csv_text(records: Iterable[Mapping[str, Any]]) -> str:
    """A line per record below the names of all columns, with DIGITS; empty where a record has no value."""
    rounded = [
        {key: float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for key, value in record.items()}
        for record in records
    ]
    return str(pd.DataFrame(rounded, dtype=object).to_csv(index=False))


def begins_with(path: Path, title: str) -> bool:
    """Whether a text file begins with ``title``, by which a report knows a file of its own."""
    try:
        with path.open("rb") as file:
            return file.read(len(title.encode())) == title.encode()
    except OSError:
        return False


def remove_all_but(written: Collection[Path], known: Iterable[Path]) -> None:
    """Remove the files among ``known`` that have not been ``written`` this time. What is no file, or cannot be removed, stays."""
    for path in known:
        if path not in written and path.is_file():
            with suppress(OSError):
                path.unlink()
