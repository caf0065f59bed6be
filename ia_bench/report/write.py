"""Write the whole report of a set of run folders: Markdown, LaTeX, CSV, and a figure of curves per scene."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.report.collect import KEPT, CellKey, Record, collect, reasons_text
from ia_bench.report.curves import draw_scene, save
from ia_bench.report.findings import MEAN, Findings, analyse
from ia_bench.report.statistics import Paired
from ia_bench.report.table import carried_text
from ia_bench.report.texts import TITLE, begins_with, csv_text, latex, remove_all_but, report_text, write_text
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS

Line = dict[str, Any]


@dataclass(frozen=True)
class Report:
    """The files that were written, and the findings in them."""

    files: tuple[Path, ...]
    findings: Findings


def write_report(
    folders: Iterable[Path] | Mapping[Path, CellKey | None],
    out: Path,
    rows_order: Sequence[str] = (),
    *,
    scenes_order: Sequence[str] = (),
    reference: str | None = None,
    claims: Sequence[Claim] = (),
    papers: Mapping[str, str] | None = None,
    published: Iterable[Record] = (),
) -> Report:
    """Write the report of run folders into ``out``.

    Files: report.md, table.{tex,csv}, runs.csv, differences.csv, claims.csv, curves/SCENE.{png,svg}.
    Curves of other scenes that a former report has left there are removed.

    Args:
        folders: The run folders, best as a mapping to (row, scene, seed): then a run that was killed before it wrote
            anything counts as a failure of its row. None: the folder's own record says which cell it is.
        out: The folder to write into.
        rows_order: Rows in their order; a row without a run is shown empty, others come after them by name.
        scenes_order: The same of scenes.
        reference: The row that all others are compared with.
        claims: Orderings to judge.
        papers: Row -> the row of the paper's table that it stands for.
        published: Runs of former reports that stand beside them; they have no curves.

    Raises:
        InputError: Where there is no run, two of them hold the same cell, ``reference`` or a row of ``claims`` is no row,
            or the paper has no such row.
    """
    collection = collect(folders, list(published))
    if not len(collection.runs):
        raise InputError("; ".join(["expected at least one run's metrics.json, found none", *collection.unreadable]))
    findings = analyse(collection, rows_order, scenes_order, reference, claims, papers)

    ours = begins_with(out / "report.md", TITLE)
    pictures = _draw(findings, out / "curves")
    if ours:
        remove_all_but(pictures, [*(out / "curves").glob("*.png"), *(out / "curves").glob("*.svg")])
    shown = [path.relative_to(out).as_posix() for path in pictures if path.suffix == ".png"]
    differences = (
        ({"row": row, "reference": findings.reference, "metric": metric.key}, values[metric.key])
        for row, values in findings.differences.items()
        for metric in METRICS
    )
    claimed = (
        ({"better": one.better, "worse": one.worse, "metric": one.metric.key, "outcome": one.outcome}, one.pairs)
        for one in findings.verdicts
    )
    tables = {"table.csv": _summaries(findings), "differences.csv": _paired(differences), "claims.csv": _paired(claimed)}
    texts = {
        "report.md": report_text(findings, shown),
        "table.tex": latex(findings),
        "runs.csv": runs_text(findings),
        **{name: csv_text({"protocol": findings.protocol, **record} for record in records) for name, records in tables.items()},
    }
    return Report((*(write_text(out / name, text) for name, text in texts.items()), *pictures), findings)


def _draw(findings: Findings, folder: Path) -> list[Path]:
    pictures = []
    for scene in findings.scenes:
        figure = draw_scene(findings.runs, scene, findings.rows)
        if figure is not None:
            folder.mkdir(parents=True, exist_ok=True)
            pictures += save(figure, folder / re.sub(r"[^\w.-]", "_", scene))
    return pictures


def runs_text(findings: Findings) -> str:
    """Every run with all its digits: what every mean and interval of the report was made from."""
    runs = findings.runs.drop(columns=[*KEPT, "problem", "protocol"])
    failed = findings.runs["problem"].notna()
    reasons = [run["problem"] or reasons_text(run) for run in findings.runs.to_dict("records")]
    labels = {"protocol": findings.protocol, "status": failed.map({False: "ok", True: "failed"}), "reason": reasons}
    runs = runs.assign(**labels)
    first = ["protocol", "row", "scene", "seed", "status", "reason", "sees_truth", *(metric.column for metric in METRICS)]
    return str(runs[[*first, *(name for name in runs if name not in first)]].to_csv(index=False))


def _summaries(findings: Findings) -> Iterable[Line]:
    parts = {"": "mean", "_half_width": "half_width", "_scenes": "scenes"}
    for block in (findings.overall, *findings.blocks):
        for one in block.lines:
            values = {
                f"{metric.column}{suffix}": (value := one.values[metric.key]) and getattr(value, part)
                for metric in METRICS
                for suffix, part in parts.items()
            }
            costs = {"seconds": one.seconds and one.seconds.mean, "peak_memory_bytes": one.peak_memory_bytes}
            label = {"scene": block.title, "row": one.row, "sees_truth": one.sees_truth}
            yield {**label, **values, **costs, "failed": one.failed, "runs": one.runs}
    for row in findings.paper:
        paper = {metric.column: row.values.get(metric.key) for metric in METRICS}
        yield {"protocol": "the paper's", "scene": "the paper's scenes", "row": row.method, **paper}


def _paired(found: Iterable[tuple[Line, Paired]]) -> Iterable[Line]:
    """The mean of differences with both intervals, then the same scene by scene, each below its label."""
    for label, pairs in found:
        for scene, part in {MEAN: pairs, **{scene: pairs.of_scene(scene) for scene in pairs.pairs}}.items():
            seeds, scenes = part.over_seeds, part.over_scenes
            yield label | {
                "scene": scene,
                "difference": seeds and seeds.mean,
                "half_width_over_seeds": seeds and seeds.half_width,
                "half_width_over_scenes": scenes and scenes.half_width,
                "pairs": part.count,
                "carried_by": carried_text(part),
            }
