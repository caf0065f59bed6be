"""The report as Markdown and LaTeX: the templates beside this file, filled from :class:`Findings`.

The templates' marks are ``<< value >>``, ``<% statement %>`` and ``<# comment #>``: braces belong to LaTeX.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from itertools import groupby

from jinja2 import Environment, PackageLoader, StrictUndefined

from ia_bench.report import table
from ia_bench.report.claims import HOW_JUDGED, tally
from ia_bench.report.findings import Findings
from ia_bench.report.statistics import Block
from ia_bench.report.table import Entry, Printed
from ia_bench.scores.columns import METRICS

TITLE = "# Results\n"
"""How the template report.md begins."""
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


def markdown_block(block: Block, notes: Mapping[str, int]) -> str:
    """One table of results in Markdown."""
    return pipe_table(table.results_table(block, notes))


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


@cache
def _templates() -> Environment:
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
    return environment


def _filled(template: str, findings: Findings, **more: object) -> str:
    results = partial(table.results_table, notes=findings.footnotes)
    return _templates().get_template(f"{template}.j2").render(findings=findings, table=table, results=results, **more)
