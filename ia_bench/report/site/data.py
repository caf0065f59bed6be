"""What the page's scripts have as data, and what its columns mean, in words."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ia_bench.common.settings import flat
from ia_bench.report.collect import TIMES, reason_of
from ia_bench.report.curves import Curve
from ia_bench.report.findings import Findings
from ia_bench.report.seconds import points
from ia_bench.report.table import BOUNDS, HEADLINE, MAIN, measured
from ia_bench.scores.metrics import CURVE_METRICS, MEASURED, METRICS, Metric

DIGITS = 5  # significant ones of a number that a script draws or sorts by
EXACT = 7  # those of a number that a script prints, so that it rounds as the table does
BRIEF = 0.05  # seconds below which a phase is not told
CHECKSUM_DIGITS = 12
MACHINE = ("cpu", "cores", "threads", "device", "system", "python", "commit")
OF_A_RUN = ("seed", "scene.", "out", "row")  # begin settings that every run tells by itself

COMPONENTS = {
    "albedo": "Albedo of the test views against the truth, as it was recovered",
    "aligned_albedo": "Albedo of the test views after one factor for all views and channels has matched its mean to the truth's",
    "view_synthesis": "Photographs from new viewpoints under the training light",
    "relighting": "Photographs under lights that no method has seen, drawn with the aligned albedo",
    "roughness": "Perceptual roughness of the test views, from 0 to 1",
    "light": "Balls of glass, gloss and chalk as they look under the recovered light, after one factor",
    "log_light": "The recovered light's log radiance, by solid angle, after one factor",
}
"""Component of a metric -> what is compared with what."""
MEASURES = {
    "psnr": "Peak signal-to-noise ratio in dB over the object's pixels, sRGB-encoded, averaged over images",
    "ssim": "Structural similarity, 1 for equal images",
    "lpips": "Perceptual distance by a network, 0 for equal images",
    "mse": "Mean squared error over the object's pixels",
}
"""Name of a metric -> how it is measured."""
COSTS = {
    "gain": "Aligned albedo PSNR minus that of the row that all are compared with, on the same scenes and seeds",
    "equal": "Aligned albedo PSNR minus the best that the row that all are compared with has after as many seconds, by more steps "
    "or more samples (part Seconds)",
    "seconds": "Baking, prior and fit, without scoring and without the preparation of the scene (its capture, a mesh made for it), "
    "which is the same for every row: mean over scenes and seeds, on the machine that each run names (or as declared)",
    "memory": "The largest resident memory of any of the row's processes",
    "failed": "Runs that ended without scores, of all runs. They enter no mean",
}
"""Key of a cost -> what it counts."""
WHY_THE_PAPER_DIFFERS = (
    "The paper measured on its own scenes, with its own renderer and trained weights, and leaves mask, encoding and alignment "
    "open. Orders may be compared, levels may not."
)


def is_headline(metric: Metric) -> bool:
    """Whether a metric is one of those that a table is read by first."""
    return metric in MAIN and metric.label in HEADLINE


def shown(findings: Findings) -> list[Metric]:
    """The paper's metrics, and of all others those that some run has."""
    known = measured(findings.overall)
    return [metric for metric in MEASURED if metric in METRICS or metric in known]


def definition(metric: Metric) -> str:
    """What a column shows, and which direction is better."""
    better = "Higher" if metric.higher_is_better else "Lower"
    said = MEASURES.get(metric.name) or (metric.of.__doc__ or metric.label).splitlines()[0].rstrip(".")  # of a metric that is new
    return f"{COMPONENTS.get(metric.component, metric.group)}. {said}. {better} is better."


def page_data(findings: Findings, title: str, page: Path, live: dict[str, Any] | None) -> dict[str, Any]:
    """Everything that the page's scripts need, as JSON types. ``page``: the folder that links to run folders start from.

    What many runs have alike, a configuration or a machine, is told once: a run names it by its place.
    """
    metrics = shown(findings)
    runs = [_run(run, page, findings, metrics) for run in findings.runs.to_dict("records")]
    own = ("key", "group", "label", "title", "digits")
    notes = {row.name: row.note for row in findings.table.crossed_rows}
    return {
        "title": title,
        "protocol": findings.protocol,
        "metrics": [
            {name: getattr(metric, name) for name in own}
            | {"higher": metric.higher_is_better, "headline": is_headline(metric), "definition": definition(metric)}
            for metric in metrics
        ],
        "curveMetrics": [metric.key for metric in CURVE_METRICS],
        "costs": COSTS,
        "rows": [
            {
                "name": line.row,
                "note": notes.get(line.row, ""),
                "bound": BOUNDS.get(line.row),
                "truth": line.sees_truth,
                "paper": (paper := findings.counterparts.get(line.row)) and {"method": paper.method, "values": paper.values},
            }
            for line in findings.overall.lines
        ],
        "scenes": list(findings.scenes),
        "whyPaper": WHY_THE_PAPER_DIFFERS,
        "configurations": _told_once(runs, "configuration"),
        "machines": _told_once(runs, "machine"),
        "runs": runs,
        "pareto": [] if findings.timing is None else points(findings.timing),
        **({} if live is None else {"live": live}),
    }


def _run(run: dict[str, Any], page: Path, of: Findings, metrics: Sequence[Metric]) -> dict[str, Any]:
    found = _evidence(run)
    machine = {**{key: run[key] for key in ("commit", "cpu", "threads") if not pd.isna(run[key])}, **found.get("machine", {})}
    phases = {name.removeprefix(TIMES): value for name, value in run.items() if name.startswith(TIMES) and value >= BRIEF}
    undefined = [] if run["problem"] is not None else [metric for metric in metrics if np.isnan(run[metric.column])]
    record = {
        "row": of.rows.index(run["row"]),
        "scene": of.scenes.index(run["scene"]),
        "seed": int(run["seed"]),
        "problem": run["problem"],
        "values": [short(run[metric.column], EXACT) for metric in metrics],
        "reasons": {metric.key: reason_of(run["reasons"], metric.key) for metric in undefined},
        "seconds": short(run["seconds"]),
        "phases": {name: round(seconds, 1) for name, seconds in phases.items()},
        "memory": None if pd.isna(run["peak_memory_bytes"]) else int(run["peak_memory_bytes"]),
        "hash": run["config_hash"],
        "preset": run["preset"],
        "command": run["command"] and f"ia-bench run {run['command']}",
        "folder": os.path.relpath(run["folder"], page).replace(os.sep, "/") if found else None,
        **found,
        "machine": machine,
        "curve": None if run["curve"] is None else curve_data(run["curve"]),
    }
    return {key: value for key, value in record.items() if value is not None and value not in ({}, [], "")}


def _told_once(runs: list[dict[str, Any]], key: str) -> list[Any]:
    """What runs have below ``key``, each once; in its place they get where it stands in this list."""
    places: dict[str, int] = {}
    for run in runs:
        if key in run:
            run[key] = places.setdefault(json.dumps(run[key]), len(places))
    return [json.loads(text) for text in places]


def _evidence(run: dict[str, Any]) -> dict[str, Any]:
    """What a run's folder says of how its numbers came about; nothing of a run that only a runs.csv knows.

    ``configuration``: flat, without what every run tells by itself; ``command``: its command line; ``machine``: machine, versions
    and commit, flat; ``files``: name -> the first digits of the SHA-256 of what the run wrote; ``renderer``: who drew the pictures
    that were scored.
    """
    record, setup = run["record"], run["setup"]
    if record is None or setup is None:
        return {}
    packages = record.environment.get("packages")
    return {
        "configuration": {name: value for name, value in flat(setup.config).items() if not name.startswith(OF_A_RUN)},
        "command": setup.command,
        "machine": {key: record.environment[key] for key in MACHINE if record.environment.get(key) is not None}
        | (flat(packages, "packages.") if isinstance(packages, dict) else {}),
        "files": {name: digest[:CHECKSUM_DIGITS] for name, digest in record.files.items()},
        "renderer": record.renderer,
    }


def curve_data(curve: Curve) -> dict[str, Any]:
    """A curve as the page's scripts have it."""
    return {
        "level": curve.is_level,
        "seconds": [short(value) for value in curve.seconds.tolist()],
        "values": [[short(value) for value in curve.values[metric.column].tolist()] for metric in CURVE_METRICS],
    }


def short(value: float | None, digits: int = DIGITS) -> float | None:
    """A number without the digits that nobody sees."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.{digits}g}")
