"""The results as one structure (:class:`Results`), and as CSV and JSON. Markdown and LaTeX are in their siblings."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from ia_bench.report.collect import Run
from ia_bench.report.statistics import Estimate, Line, line
from ia_bench.scores.columns import METRICS, Metric

OVERALL = "mean over scenes"
PAPER_TITLE = "The paper's own figures: the paper's scenes and renderer, not ours; do not compare with the rows above"


@dataclass(frozen=True)
class Block:
    """One table: the lines of all rows over one scene, or over all ``scenes`` of them."""

    title: str
    lines: tuple[Line, ...]
    scenes: int = 1


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's table 1: ``group`` as the paper divides it, ``values`` by :attr:`Metric.key`."""

    method: str
    group: str
    values: dict[str, float]


@dataclass(frozen=True)
class Results:
    """What every format prints: the overall block, one block per scene, and the paper's rows."""

    protocol: str
    overall: Block
    scenes: tuple[Block, ...]
    paper: tuple[PaperRow, ...]


def summarise(runs: Sequence[Run], rows: Sequence[str], scenes: Sequence[str], protocol: str) -> Results:
    """Summarise the runs in the order of ``rows`` and ``scenes``; a row without any run still gets its line."""
    per_scene = [
        Block(scene, tuple(line([run for run in runs if run.scene == scene], row) for row in rows)) for scene in scenes
    ]
    overall = Block(OVERALL, tuple(line(runs, row) for row in rows), len(scenes))
    return Results(protocol, overall, tuple(per_scene), paper_rows())


def paper_rows() -> tuple[PaperRow, ...]:
    """Table 1 of the IntrinsicAnything paper, shipped as data."""
    text = resources.files("ia_bench.report").joinpath("paper_table1.csv").read_text(encoding="utf-8")
    return tuple(
        PaperRow(cells["method"], cells["group"], {metric.key: float(cells[metric.column]) for metric in METRICS})
        for cells in csv.DictReader(io.StringIO(text))
    )


def best_paper_methods(rows: Sequence[PaperRow], metric: Metric) -> set[str]:
    """The methods that the paper prints in bold for this metric: the best, all rows ranked together."""
    best = (max if metric.higher_is_better else min)(row.values[metric.key] for row in rows)
    return {row.method for row in rows if row.values[metric.key] == best}


def estimate_text(value: Estimate | None, metric: Metric, scenes: int = 1, plus_minus: str = " ± ") -> str:
    """The mean, the interval where there is one, and the number of scenes where some are missing; – for no value."""
    if value is None:
        return "–"
    interval = "" if value.half_width is None else f"{plus_minus}{metric.text(value.half_width)}"
    missing = f" ({value.scenes}/{scenes})" if value.scenes < scenes else ""
    return f"{metric.text(value.mean)}{interval}{missing}"


def cost_texts(one: Line) -> tuple[str, str, str]:
    """Seconds, peak memory and failures of one line, as every format prints them."""
    seconds = "–" if one.seconds is None else f"{one.seconds.mean:.1f}"
    memory = "–" if one.peak_memory_bytes is None else f"{one.peak_memory_bytes / 2**20:.0f} MiB"
    return seconds, memory, f"{one.failed}/{one.runs}"


def csv_text(results: Results) -> str:
    """All blocks in one CSV: a line per block and row; the paper's rows carry the scene "the paper's scenes"."""
    out = io.StringIO()
    parts = ("", "_half_width", "_scenes")
    names = [f"{metric.column}{part}" for metric in METRICS for part in parts]
    costs = ["seconds", "peak_memory_bytes", "failed", "runs"]
    writer = csv.DictWriter(out, ["scene", "row", "sees_truth", *names, *costs], lineterminator="\n")
    writer.writeheader()
    for block in (results.overall, *results.scenes):
        for one in block.lines:
            cells: dict[str, Any] = {"scene": block.title, "row": one.row, "sees_truth": one.sees_truth}
            for metric in METRICS:
                if (value := one.values[metric.key]) is not None:
                    numbers = (value.mean, value.half_width, value.scenes)
                    cells.update({f"{metric.column}{part}": n for part, n in zip(parts, numbers, strict=True)})
            cells["seconds"] = one.seconds and one.seconds.mean
            writer.writerow(cells | {key: getattr(one, key) for key in costs[1:]})
    for row in results.paper:
        paper = {metric.column: row.values[metric.key] for metric in METRICS}
        writer.writerow({"scene": "the paper's scenes", "row": row.method, **paper})
    return out.getvalue()


def json_data(results: Results) -> dict[str, Any]:
    """The same as JSON types, everything at full precision."""

    def block(one: Block) -> list[dict[str, Any]]:
        return [_json_line(row) for row in one.lines]

    return {
        "schema": 1,
        "protocol": results.protocol,
        "metrics": {metric.key: {"higher_is_better": metric.higher_is_better} for metric in METRICS},
        "overall": block(results.overall),
        "scenes": {one.title: block(one) for one in results.scenes},
        "paper": {
            "note": PAPER_TITLE,
            "rows": [{"row": row.method, "group": row.group, "values": row.values} for row in results.paper],
        },
    }


def _json_line(one: Line) -> dict[str, Any]:
    def estimate(value: Estimate | None) -> dict[str, Any] | None:
        return None if value is None else {"mean": value.mean, "half_width": value.half_width, "scenes": value.scenes}

    return {
        "row": one.row,
        "sees_truth": one.sees_truth,
        "values": {key: estimate(value) for key, value in one.values.items()},
        "seconds": estimate(one.seconds),
        "peak_memory_bytes": one.peak_memory_bytes,
        "failed": one.failed,
        "runs": one.runs,
    }
