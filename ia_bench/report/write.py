"""Write the whole report of a set of run folders: Markdown, LaTeX, CSV, and a figure of curves per scene.

The templates beside this file are filled from :class:`Findings`. Their marks are ``<< value >>``, ``<% statement %>`` and
``<# comment #>``: braces belong to LaTeX.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError, listed
from ia_bench.report import statistics
from ia_bench.report import table as tables
from ia_bench.report.blocks import PSNRS
from ia_bench.report.collect import KEPT, CellKey, Record, collect, reasons_text
from ia_bench.report.curves import draw_pareto, draw_scene, save
from ia_bench.report.findings import MEAN, Findings, analyse
from ia_bench.report.seconds import points, seconds_records
from ia_bench.report.statistics import Paired
from ia_bench.report.table import Entry, Printed, carried_text
from ia_bench.runs.table import Table
from ia_bench.scores.metrics import MEASURED, METRICS

TITLE = "# Results\n"
"""How the template report.md begins."""
PARETO = "pareto"
SECONDS_FILES = ("seconds.csv", f"{PARETO}.png", f"{PARETO}.svg")
"""What a report has where rows are compared with a reference."""
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
    "‡": r"$^\ddagger$",
    "“": "``",
    "”": "''",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
}
MARKS = dict(block_start="<%", block_end="%>", variable_start="<<", variable_end=">>", comment_start="<#", comment_end="#>")


@dataclass(frozen=True)
class Report:
    """The files that were written, and the findings in them."""

    files: tuple[Path, ...]
    findings: Findings


def write_report(
    folders: Iterable[Path] | Mapping[Path, CellKey | None], out: Path, table: Table | None = None, published: Iterable[Record] = ()
) -> Report:
    """Write the report of run folders into ``out``.

    Files: report.md, table.{tex,csv}, runs.csv, differences.csv, claims.csv, seconds.csv and pareto.{png,svg} where rows are
    compared with a reference, curves/SCENE.{png,svg}.
    Curves of other scenes that a former report has left there are removed.

    Args:
        folders: The run folders, best as a mapping to (row, scene, seed): then a run that was killed before it wrote
            anything counts as a failure of its row. None: the folder's own record says which cell it is.
        out: The folder to write into.
        table: Which rows and scenes there are, in their order, the row that all others are compared with, and what is claimed.
        published: Runs of former reports that stand beside them; they have no curves.

    Raises:
        InputError: Where there is no run, two of them hold the same cell, the table's reference is no row, or the paper has no
            row that one of the table stands for.
    """
    collection = collect(folders, list(published))
    if not len(collection.runs):
        raise InputError("; ".join(["expected at least one run's metrics.json, found none", *collection.unreadable]))
    findings = analyse(collection, table)
    if findings.table.compared is not None and findings.reference is None:
        raise InputError(f"reference: expected one of the rows {listed(findings.rows)}, found {findings.table.compared}")
    known = {*findings.rows, *(row.name for row in findings.table.rows)}  # of a table's own rows some may not have been run
    if unknown := [row for row in findings.table.curve if row not in known]:
        raise InputError(f"curve: expected some of the rows {listed(findings.rows)}, found {unknown[0]}")
    ours = begins_with(out / "report.md", TITLE)
    pictures = _draw(findings, out)
    if ours:
        curves = [path for path in (out / "curves").glob("*") if path.suffix in (".png", ".svg")]
        remove_all_but(pictures, [*(out / name for name in SECONDS_FILES), *curves])
    differences = (
        ({"row": row, "reference": findings.reference, "metric": metric.key}, values[metric.key], findings.scenes)
        for row, values in findings.differences.items()
        for metric in MEASURED
        if metric in METRICS or values[metric.key].pairs
    )
    claimed = (
        ({"better": one.better, "worse": one.worse, "metric": one.metric.key, "outcome": one.outcome}, one.pairs, findings.scenes)
        for one in findings.verdicts
    )
    records = {"table.csv": _summaries(findings), "differences.csv": _paired(differences), "claims.csv": _paired(claimed)}
    records |= {"seconds.csv": seconds_records(findings.timing)} if findings.timing else {}
    shown = [path.relative_to(out).as_posix() for path in pictures if path.suffix == ".png" and path.stem != PARETO]
    groups = [(name, len(list(metrics))) for name, metrics in groupby(METRICS, key=lambda metric: metric.group)]
    texts = {
        "report.md": filled("report.md", findings, pictures=shown, pareto=any(path.stem == PARETO for path in pictures)),
        "table.tex": filled("table.tex", findings, groups=groups, metrics=METRICS, columns=1 + len(METRICS)),
        "runs.csv": _runs_text(findings),
        **{name: csv_text({"protocol": findings.protocol, **one} for one in lines) for name, lines in records.items()},
    }
    return Report((*(write_whole(out / name, text) for name, text in texts.items()), *pictures), findings)


def _draw(findings: Findings, out: Path) -> list[Path]:
    pictures: list[Path] = []
    for scene in findings.scenes:
        if (figure := draw_scene(findings.runs, scene, findings.rows)) is not None:
            name = re.sub(r"[^\w.-]", "_", scene)
            while out / "curves" / f"{name}.png" in pictures:  # of "my hat", where this is my_hat
                name += "_"
            pictures += save(figure, out / "curves" / name)
    front = None if findings.timing is None else draw_pareto(points(findings.timing), findings.rows)
    return pictures if front is None else [*pictures, *save(front, out / PARETO)]


def _runs_text(findings: Findings) -> str:
    """Every run with all its digits: what every mean and interval of the report was made from."""
    failed = findings.runs["problem"].notna()
    reasons = [run["problem"] or reasons_text(run) for run in findings.runs.to_dict("records")]
    labels = {"protocol": findings.protocol, "status": failed.map({False: "ok", True: "failed"}), "reason": reasons}
    runs = findings.runs.drop(columns=[*KEPT, "problem", "protocol"]).assign(**labels)
    first = ["protocol", "row", "scene", "seed", "status", "reason", "sees_truth", *(metric.column for metric in MEASURED)]
    return str(runs[[*first, *(name for name in runs if name not in first)]].to_csv(index=False))


def _summaries(findings: Findings) -> Iterable[Record]:
    parts = {"": "mean", "_half_width": "half_width", "_half_width_over_scenes": "wider", "_scenes": "scenes"}
    metrics = [metric for metric in MEASURED if metric in METRICS or metric in tables.measured(findings.overall)]
    for block in (findings.overall, *findings.blocks):
        for one in block.lines:
            values = {
                f"{metric.column}{suffix}": (value := one.values[metric.key]) and getattr(value, part)
                for metric in metrics
                for suffix, part in parts.items()
            }
            values |= {f"{m.column}_whole_image": (value := one.whole[m.key]) and value.mean for m in PSNRS}
            costs = {"seconds": one.seconds and one.seconds.mean, "peak_memory_bytes": one.peak_memory_bytes}
            label = {"scene": block.title, "row": one.row, "sees_truth": one.sees_truth}
            yield {**label, **values, **costs, "failed": one.failed, "runs": one.runs, **findings.made.get(one.row, {})}
    for row in findings.paper:
        paper = {metric.column: row.values.get(metric.key) for metric in METRICS}
        yield {"protocol": "the paper's", "scene": "the paper's scenes", "row": row.method, **paper}


def _paired(found: Iterable[tuple[Record, Paired, Collection[str]]]) -> Iterable[Record]:
    """The mean of differences with both intervals, then the same scene by scene, each below its label.

    The mean has a p-value where none of the scenes that it should be over is missing.
    """
    for label, pairs, scenes in found:
        for scene, part in {MEAN: pairs, **{scene: pairs.of_scene(scene) for scene in pairs.pairs}}.items():
            seeds = part.over_seeds
            yield label | {
                "scene": scene,
                "difference": seeds and seeds.mean,
                "half_width_over_seeds": seeds and seeds.half_width,
                "half_width_over_scenes": seeds and seeds.wider,
                "half_width_new_scene": part.new_scene,
                "p_value": None if scene == MEAN and pairs.pairs.keys() < {*scenes} else part.p_value,
                "scenes": len(part.pairs),
                "scenes_above": part.signs and part.signs[0],
                "sign_test_p_value": part.signs and part.signs[2],
                "pairs": part.count,
                "carried_by": carried_text(part),
            }


# ---- texts ------------------------------------------------------------------------------------------------------------


def pipe_table(one: Printed) -> str:
    """A Markdown table, first column to the left, the others to the right."""
    rule = [":---", *["---:"] * (len(one.header) - 1)]
    lines = [list(map(_markdown, one.header)), rule, *([_markdown(cell) for cell in cells] for cells in one.body)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def _markdown(cell: Entry | str) -> str:
    """An entry in one line, with its names kept from being read as markup, or as mathematics, which is between dollar signs."""
    cell = Entry(cell) if isinstance(cell, str) else cell
    text = "".join(f"\\{letter}" if letter in "\\`*_|[]<>$~" else letter for letter in _one_line(cell.text))
    return (f"**{text}**" if cell.best else text) + "".join(f"[^{number}]" for number in cell.notes)


def _one_line(text: str) -> str:
    """The text in one line: those of others' records may have lines that begin a heading, or empty ones, which end a caption."""
    return " ".join(filter(None, text.splitlines()))


def tex(cell: Entry | str) -> str:
    """An entry with its special characters kept from being read as commands."""
    cell = Entry(cell) if isinstance(cell, str) else cell
    told = _one_line(cell.text).replace(" †", "†").replace(" ‡", "‡")
    text = "".join(LATEX.get(letter, letter) for letter in told).replace(r" $\pm$ ", r"\,$\pm$\,")
    text = f"{{}}{text}" if text[:1] in ("[", "*") else text  # which the end of the line before would take for its own
    notes = f"$^{{{','.join(map(str, cell.notes))}}}$" if cell.notes else ""
    return (rf"\textbf{{{text}}}" if cell.best else text) + notes


def filled(template: str, findings: Findings, **more: object) -> str:
    """A template, filled; it is not HTML: names are escaped by the filters ``markdown`` and ``tex``."""
    options: dict[str, Any] = {f"{name}_string": mark for name, mark in MARKS.items()}
    options |= dict.fromkeys(("trim_blocks", "lstrip_blocks", "keep_trailing_newline"), True)
    environment = Environment(undefined=StrictUndefined, loader=PackageLoader("ia_bench.report"), autoescape=False, **options)
    environment.filters.update(markdown=_markdown, pipe=pipe_table, tex=tex)
    results = partial(tables.results_table, notes=findings.footnotes)
    words = {"findings": findings, "table": tables, "statistics": statistics, "results": results}
    return environment.get_template(f"{template}.j2").render(**words, **more)


def csv_text(records: Iterable[Mapping[str, Any]]) -> str:
    """A line per record below the names of all columns, with DIGITS; empty where a record has no value."""
    rounded = [
        {key: float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for key, value in record.items()}
        for record in records
    ]
    return str(pd.DataFrame(rounded, dtype=object).to_csv(index=False))


# ---- files ------------------------------------------------------------------------------------------------------------


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file at once or not at all, and return its path; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


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
