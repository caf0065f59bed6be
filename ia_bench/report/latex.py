"""The table in LaTeX, in the layout of the paper's table 1. The document needs the packages booktabs and graphicx."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from ia_bench.report.statistics import best_rows
from ia_bench.report.table import (
    PAPER_TITLE,
    Block,
    PaperRow,
    Results,
    best_paper_methods,
    cost_texts,
    estimate_text,
)
from ia_bench.scores.columns import METRICS, Metric

COSTS = ("Seconds", "Memory", "Failed")
FOOTNOTE = r"$^\dagger$ sees the ground truth and is not ranked."
COLUMNS = 1 + len(METRICS) + len(COSTS)
ESCAPES = {letter: f"\\{letter}" for letter in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


def latex(results: Results) -> str:
    """One ``table*`` for the overall results with the paper's figures below them, then one per scene."""
    tables = [_table(results.overall, f"Mean over {results.overall.scenes} scenes", results, results.paper)]
    tables += [_table(block, f"Scene {escape(block.title)}", results) for block in results.scenes]
    return "\n".join(tables)


def escape(text: str) -> str:
    """Keep a name's special characters from being read as commands."""
    return "".join(ESCAPES.get(letter, letter) for letter in text)


def _table(block: Block, caption: str, results: Results, paper: Sequence[PaperRow] = ()) -> str:
    groups = [(name, len(list(metrics))) for name, metrics in groupby(METRICS, key=lambda metric: metric.group)]
    rules, column = [], 2
    for _, width in groups:
        rules.append(rf"\cmidrule(lr){{{column}-{column + width - 1}}}")
        column += width
    lines = [
        r"\begin{table*}[t]",
        r"\centering",
        rf"\caption{{{caption}. Protocol {escape(results.protocol)}. {FOOTNOTE}}}",
        r"\resizebox{\linewidth}{!}{",
        rf"\begin{{tabular}}{{l{'r' * (COLUMNS - 1)}}}",
        r"\toprule",
        _row(["", *(rf"\multicolumn{{{width}}}{{c}}{{{name}}}" for name, width in groups), *[""] * len(COSTS)]),
        " ".join(rules),
        _row(["Method", *(metric.label + _arrow(metric) for metric in METRICS), *COSTS]),
        r"\midrule",
        *_our_rows(block),
        *_paper_rows(paper),
        r"\bottomrule",
        r"\end{tabular}",
        "}",
        r"\end{table*}",
    ]
    return "\n".join(lines) + "\n"


def _our_rows(block: Block) -> list[str]:
    best = {metric.key: best_rows(block.lines, metric, block.scenes) for metric in METRICS}
    rows = []
    for one in block.lines:
        cells = [escape(one.row) + (r"$^\dagger$" if one.sees_truth else "")]
        for metric in METRICS:
            text = estimate_text(one.values[metric.key], metric, block.scenes, r"\,$\pm$\,").replace("–", "--")
            cells.append(rf"\textbf{{{text}}}" if one.row in best[metric.key] else text)
        rows.append(_row([*cells, *(text.replace("–", "--") for text in cost_texts(one))]))
    return rows


def _paper_rows(paper: Sequence[PaperRow]) -> list[str]:
    best = {metric.key: best_paper_methods(paper, metric) for metric in METRICS} if paper else {}
    rows = [r"\midrule", rf"\multicolumn{{{COLUMNS}}}{{l}}{{\emph{{{PAPER_TITLE}}}}} \\"] if paper else []
    for _, group in groupby(paper, key=lambda row: row.group):
        rows.append(r"\midrule")
        for row in group:
            texts = [(metric.text(row.values[metric.key]), row.method in best[metric.key]) for metric in METRICS]
            values = (rf"\textbf{{{text}}}" if bold else text for text, bold in texts)
            rows.append(_row([escape(row.method), *values, *[""] * len(COSTS)]))
    return rows


def _arrow(metric: Metric) -> str:
    return r"$\uparrow$" if metric.higher_is_better else r"$\downarrow$"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"
