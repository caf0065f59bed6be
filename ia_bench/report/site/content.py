"""What the page says: the numbers for its templates with what they mean, and the same as data for its scripts."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ia_bench.common.errors import InputError
from ia_bench.common.settings import flat
from ia_bench.report.collect import HASH_DIGITS, TIMES, reason_of, setup_of
from ia_bench.report.curves import Curve
from ia_bench.report.findings import Findings
from ia_bench.report.statistics import Block, Estimate, Line
from ia_bench.report.table import BOUNDS, HEADLINE, estimate_text
from ia_bench.report.worth import Map
from ia_bench.runs.record import RunRecord
from ia_bench.runs.table import Row
from ia_bench.scores.columns import CURVE_METRICS, METRICS, Metric

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
    "seconds": "Baking, prior and fit, without scoring and without the preparation of the scene (its capture, a mesh made for it), "
    "which is the same for every row: mean over scenes and seeds, on the machine that each run names",
    "memory": "The largest resident memory of any of the row's processes",
    "failed": "Runs that ended without scores, of all runs. They enter no mean",
}
"""Key of a cost -> what it counts."""
WHY_THE_PAPER_DIFFERS = (
    "The paper measured on its own scenes, with its own renderer and trained weights, and leaves mask, encoding and alignment "
    "open. Orders may be compared, levels may not."
)


@dataclass
class Gallery:
    """The pictures of a page: plain data, so that a page without any needs no renderer.

    Attributes:
        scenes: Scene -> what the page has to know to show its pictures (JSON types).
        missing: A sentence for each scene or row that has no pictures.
    """

    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    @property
    def relit(self) -> bool:
        """Whether any scene has a light that no method has seen."""
        return any(scene["lights"] for scene in self.scenes.values())


@dataclass(frozen=True)
class Sources:
    """What a page is made from.

    Attributes:
        findings: Everything that the report says.
        title: What the page is called.
        rows: Those of the table, whose notes and overrides are told.
        worth: Maps of what rows are worth, where scenes were photographed in several ways.
        live: What a page that is watched has to know: by which "key" its finished cells are known, and "every" how many seconds
            there are news; None for a report.
    """

    findings: Findings
    title: str
    rows: Sequence[Row] = ()
    worth: Sequence[Map] = ()
    live: dict[str, Any] | None = None


@dataclass(frozen=True)
class Number:
    """One entry of the table.

    Attributes:
        key: Of the metric or the cost.
        text: The mean as it is printed, – where there is none.
        value: What the entry is sorted by, None where there is none.
        width: The interval's half width as it is printed, empty where there is none.
        share: How much of the way from floor to ceiling it goes, in percent; None where that is not known.
        best: Whether it leads those that do not see the truth, and that is decided.
        why: Why there is no value, or not for all scenes.
        headline: Whether it is shown before somebody asks for everything.
    """

    key: str
    text: str
    value: float | None
    width: str = ""
    share: float | None = None
    best: bool = False
    why: str = ""
    headline: bool = True


def scopes(findings: Findings) -> list[tuple[Block, list[tuple[Line, list[Number]]]]]:
    """The mean over scenes, where there are several, then every scene: each with a line of numbers for every row."""
    blocks = [*([findings.overall] if len(findings.scenes) > 1 else []), *findings.blocks]
    return [(block, [(one, _numbers(one, block)) for one in block.lines]) for block in blocks]


def is_headline(metric: Metric) -> bool:
    """Whether a metric is one of those that a table is read by first."""
    return metric.label in HEADLINE


def definition(metric: Metric) -> str:
    """What a column shows, and which direction is better."""
    better = "Higher" if metric.higher_is_better else "Lower"
    said = MEASURES.get(metric.name) or (metric.of.__doc__ or metric.label).splitlines()[0].rstrip(".")  # of a metric that is new
    return f"{COMPONENTS[metric.component]}. {said}. {better} is better."


def data(sources: Sources, page: Path) -> dict[str, Any]:
    """Everything that the page's scripts need, as JSON types. ``page``: the folder that links to run folders start from.

    What many runs have alike, a configuration or a machine, is told once: a run names it by its place.
    """
    findings = sources.findings
    once: tuple[dict[str, int], dict[str, int]] = {}, {}
    runs = [_run(run, page, findings, *once) for run in findings.runs.to_dict("records")]
    configurations, machines = ([json.loads(text) for text in places] for places in once)
    return {
        "title": sources.title,
        "protocol": findings.protocol,
        "metrics": [_metric(metric) for metric in METRICS],
        "curveMetrics": [metric.key for metric in CURVE_METRICS],
        "costs": COSTS,
        "rows": [_row(row, sources) for row in findings.rows],
        "scenes": list(findings.scenes),
        "whyPaper": WHY_THE_PAPER_DIFFERS,
        "configurations": configurations,
        "machines": machines,
        "runs": runs,
        **({} if sources.live is None else {"live": sources.live}),
    }


def _metric(metric: Metric) -> dict[str, Any]:
    own = {name: getattr(metric, name) for name in ("key", "group", "label", "title", "digits")}
    return own | {"higher": metric.higher_is_better, "headline": is_headline(metric), "definition": definition(metric)}


def _row(name: str, sources: Sources) -> dict[str, Any]:
    findings, row = sources.findings, next((one for one in sources.rows if one.name == name), Row(name, []))
    paper, line = findings.counterparts.get(name), next(one for one in findings.overall.lines if one.row == name)
    return {
        "name": name,
        "note": row.note,
        "bound": BOUNDS.get(name),
        "truth": line.sees_truth,
        "paper": paper and {"method": paper.method, "values": paper.values},
        "command": shlex.join(["python", "-m", "ia_bench", *row.overrides]) if row.overrides else "",
    }


def _run(
    run: dict[str, Any], page: Path, of: Findings, configurations: dict[str, int], machines: dict[str, int]
) -> dict[str, Any]:
    found = _evidence(run)
    machine = {**{key: run[key] for key in ("commit", "cpu", "threads") if not pd.isna(run[key])}, **found.pop("machine", {})}
    phases = {name.removeprefix(TIMES): value for name, value in run.items() if name.startswith(TIMES) and value >= BRIEF}
    failed = run["problem"] is not None
    record = {
        "row": of.rows.index(run["row"]),
        "scene": of.scenes.index(run["scene"]),
        "seed": int(run["seed"]),
        "problem": run["problem"],
        "values": [short(run[metric.column], EXACT) for metric in METRICS],
        "reasons": {} if failed else {m.key: reason_of(run["reasons"], m.key) for m in METRICS if np.isnan(run[m.column])},
        "seconds": short(run["seconds"]),
        "phases": {name: round(seconds, 1) for name, seconds in phases.items()},
        "memory": None if pd.isna(run["peak_memory_bytes"]) else int(run["peak_memory_bytes"]),
        "hash": run["config_hash"],
        "preset": run["preset"],
        "folder": os.path.relpath(run["folder"], page).replace(os.sep, "/") if found else None,
        "configuration": _place(found.pop("settings", {}), configurations),
        "machine": _place(machine, machines),
        **found,
        "curve": None if run["curve"] is None else curve_data(run["curve"]),
    }
    return {key: value for key, value in record.items() if value is not None and value not in ({}, [], "")}


def _place(entry: dict[str, Any], places: dict[str, int]) -> int | None:
    return places.setdefault(json.dumps(entry), len(places)) if entry else None


def _evidence(run: Mapping[str, Any]) -> dict[str, Any]:
    """What a run's folder says of how its numbers came about; nothing of a run that only a runs.csv knows.

    ``settings``: its configuration, flat; ``command``: its command line; ``machine``: machine, versions and commit, flat;
    ``files``: name -> the first digits of the SHA-256 of what the run wrote; ``renderer``: who drew the pictures that were scored.
    """
    setup = setup_of(run["folder"])
    try:
        record = RunRecord.read(run["folder"])
    except (InputError, FileNotFoundError):
        return {}
    if setup is None or (record.row != run["row"] and record.config_hash[:HASH_DIGITS] != run["config_hash"]):
        return {}  # the folder may be that of a report, not of this run
    packages = record.environment.get("packages")
    return {
        "settings": {name: value for name, value in flat(setup.config).items() if not name.startswith(OF_A_RUN)},
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


def _numbers(one: Line, block: Block) -> list[Number]:
    ends = {BOUNDS[line.row]: line.values for line in block.lines if line.row in BOUNDS}
    numbers = []
    for metric in METRICS:
        value = one.values[metric.key]
        text, _, width = estimate_text(value, metric, block.scenes).partition(" ± ")
        share = _share(value, *(ends.get(name, {}).get(metric.key) for name in ("floor", "ceiling")))
        best, why = block.is_best(one.row, metric), "; ".join(one.reasons[metric.key])
        mean = None if value is None else short(value.mean)
        numbers.append(Number(metric.key, text, mean, width, share, best, why, is_headline(metric)))
    seconds, memory = None if one.seconds is None else one.seconds.mean, one.peak_memory_bytes
    return [
        *numbers,
        Number("seconds", "–" if seconds is None else f"{seconds:.1f}", short(seconds)),
        Number("memory", "–" if memory is None else f"{memory / 2**20:.0f}", short(memory), headline=False),
        Number("failed", f"{one.failed}/{one.runs}", one.failed),
    ]


def _share(value: Estimate | None, floor: Estimate | None, ceiling: Estimate | None) -> float | None:
    if value is None or floor is None or ceiling is None or floor.mean == ceiling.mean:
        return None
    return round(100 * min(max((value.mean - floor.mean) / (ceiling.mean - floor.mean), 0.0), 1.0), 1)
