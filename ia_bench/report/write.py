"""Write the whole report of a set of run folders: Markdown, LaTeX, CSV, JSON, and a figure of curves per scene."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ia_bench.common.atomic_file import whole_file
from ia_bench.report import figures
from ia_bench.report.collect import Cell, Run, collect, find_run_folders
from ia_bench.report.curves import TimeToError
from ia_bench.report.findings import Findings, analyse
from ia_bench.report.latex import latex
from ia_bench.report.markdown import report_text
from ia_bench.report.table import csv_text, json_data
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS


@dataclass(frozen=True)
class Report:
    """The files that were written, and the findings in them."""

    files: tuple[Path, ...]
    findings: Findings


def write_report(
    runs: Path | Sequence[Path] | Mapping[Path, Cell],
    out: Path,
    rows_order: Sequence[str] = (),
    *,
    scenes_order: Sequence[str] = (),
    reference: str | None = None,
    claims: Sequence[Claim] = (),
) -> Report:
    """Write the report into ``out``: report.md, table.{tex,csv,json}, runs.csv, time_to_{error,beat}.csv, curves/SCENE.{png,svg}.

    ``runs`` is a folder that is searched for run folders, or a table's run folders, best as a mapping to (row, scene,
    seed): then a run that was killed before it wrote anything counts as a failure of its row. Rows and scenes come in
    the given order, others after them by name; a row without a run is shown empty. ``reference`` names the row that all
    others are compared with, scene by scene; ``claims`` are orderings to judge.
    Raises ValueError where no run is found, two folders hold the same cell, ``reference`` or a row of ``claims`` is no row,
    or a claim is about an unknown metric.
    """
    collection = collect(find_run_folders(runs) if isinstance(runs, Path) else runs)
    if not collection.runs and not collection.unreadable:
        raise ValueError(f"{runs}: expected at least one run folder with a metrics.json, found none")
    findings = analyse(collection, rows_order, scenes_order, reference, claims)

    out.mkdir(parents=True, exist_ok=True)
    pictures = _draw(findings, out / "curves")
    shown = [path.relative_to(out).as_posix() for path in pictures if path.suffix == ".png"]
    texts = {
        "report.md": report_text(findings, shown),
        "table.tex": latex(findings.results),
        "table.csv": csv_text(findings.results),
        "table.json": json.dumps(_json(findings), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
        "runs.csv": _runs_csv(findings.runs),
        "time_to_error.csv": _times_csv(findings.times),
        "time_to_beat.csv": _times_csv(findings.beats),
    }
    return Report((*(_write(out / name, text) for name, text in texts.items()), *pictures), findings)


def _draw(findings: Findings, folder: Path) -> list[Path]:
    pictures = []
    for scene in findings.scenes:
        figure = figures.draw_scene(findings.runs, scene, findings.rows)
        if figure is not None:
            folder.mkdir(exist_ok=True)
            pictures += figures.save(figure, folder / re.sub(r"[^\w.-]", "_", scene))
    return pictures


def _json(findings: Findings) -> dict[str, Any]:
    differences = {
        row: {key: value and asdict(value) for key, value in values.items()}
        for row, values in findings.differences.items()
    }
    return json_data(findings.results) | {
        "differences": {"reference": findings.reference, "rows": differences},
        "claims": [
            {
                "better": one.better,
                "worse": one.worse,
                "metric": one.metric.key,
                "advantage": one.advantage and asdict(one.advantage),
                "outcome": one.outcome.value,
            }
            for one in findings.verdicts
        ],
        "worsening": [one.text for one in findings.worsening],
        "failures": findings.failures,
        "notes": findings.notes,
    }


def _runs_csv(runs: Sequence[Run]) -> str:
    """One line a run, at full precision: what every mean and interval of the report was made from."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    about = ["seconds", "peak_memory_bytes", "commit", "cpu", "problem"]
    writer.writerow(["row", "scene", "seed", *(metric.column for metric in METRICS), *about])
    for run in runs:
        values = [run.metrics.get(metric.key) for metric in METRICS]
        writer.writerow([run.row, run.scene, run.seed, *values, *(getattr(run, name) for name in about)])
    return out.getvalue()


def _times_csv(times: Sequence[TimeToError]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["scene", "row", "metric", "level", "seconds", "seeds_reached", "seeds"])
    for one in times:
        seconds = "never" if one.seconds is None else one.seconds.mean
        writer.writerow([one.scene, one.row, one.metric.key, one.level, seconds, one.reached, one.seeds])
    return out.getvalue()


def _write(path: Path, text: str) -> Path:
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path
