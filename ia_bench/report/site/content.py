"""What the page says: the numbers for its templates, and the same as data for its scripts."""

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

from ia_bench.report.collect import TIMES, reason_of
from ia_bench.report.curve import Curve
from ia_bench.report.findings import Findings
from ia_bench.report.gains import Map
from ia_bench.report.origins import seconds_compare
from ia_bench.report.site.definitions import COSTS, WHY_THE_PAPER_DIFFERS, definition
from ia_bench.report.site.evidence import evidence_of
from ia_bench.report.statistics import Block, Estimate, Leader, Line
from ia_bench.report.table import BOUNDS, HEADLINE, estimate_text
from ia_bench.scores.columns import CURVE_METRICS, METRICS, Metric

DIGITS = 5  # significant ones of a number that a script draws or sorts by
EXACT = 7  # those of a number that a script prints, so that it rounds as the table does
BRIEF = 0.05  # seconds below which a phase is not told


@dataclass(frozen=True)
class RowTexts:
    """What a table says of a row beside its numbers.

    Attributes:
        note: What a reader has to know of it.
        overrides: Of the configuration, which make it.
    """

    note: str = ""
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Live:
    """What a page has to know that is watched: which finished cells it shows, and how many seconds lie between news."""

    key: str
    every: float


@dataclass(frozen=True)
class Sources:
    """What a page is made from.

    Attributes:
        findings: Everything that the report says.
        title: What the page is called.
        rows: Texts of the rows that have some.
        live: What a page that is watched has to know, None for a report.
        worth: Maps of what rows are worth, where scenes were photographed in several ways.
    """

    findings: Findings
    title: str
    rows: Mapping[str, RowTexts] = field(default_factory=dict)
    live: Live | None = None
    worth: Sequence[Map] = ()

    @property
    def seconds_compare(self) -> bool:
        """Whether the table may be sorted by seconds."""
        return seconds_compare(self.findings.runs)


@dataclass(frozen=True)
class Number:
    """One entry of the table.

    Attributes:
        key: Of the metric or the cost.
        text: The mean as it is printed, – where there is none.
        width: The interval's half width as it is printed, empty where there is none.
        value: What the entry is sorted by, empty where there is none.
        share: How much of the way from floor to ceiling it goes, in percent; None where that is not known.
        best: Whether it leads those that do not see the truth, and that is decided.
        why: Why there is no value, or not for all scenes.
        headline: Whether it is shown before somebody asks for everything.
    """

    key: str
    text: str
    width: str = ""
    value: str = ""
    share: float | None = None
    best: bool = False
    why: str = ""
    headline: bool = True


@dataclass(frozen=True)
class Scope:
    """The table over one scene, or over all: the leaders of its headline metrics, and a line of numbers for every row."""

    name: str
    leaders: tuple[tuple[Metric, Leader], ...]
    lines: tuple[tuple[Line, tuple[Number, ...]], ...]


def scopes(findings: Findings) -> list[Scope]:
    """The mean over scenes, where there are several, then every scene."""
    found = []
    for block in [*([findings.overall] if len(findings.scenes) > 1 else []), *findings.blocks]:
        bounds = _bounds(block)
        lines = tuple((one, tuple(_numbers(one, block, bounds))) for one in block.lines)
        leading = (metric for metric in METRICS if is_headline(metric) and metric.key in block.leaders)
        found.append(Scope(block.title, tuple((metric, block.leaders[metric.key]) for metric in leading), lines))
    return found


def is_headline(metric: Metric) -> bool:
    """Whether a metric is one of those that a table is read by first."""
    return metric.label in HEADLINE


def data(sources: Sources, page: Path) -> dict[str, Any]:
    """Everything that the page's scripts need, as JSON types. ``page``: the folder that links to run folders start from."""
    findings = sources.findings
    configurations, machines = _Once(), _Once()
    runs = [_run(run, page, findings, configurations, machines) for run in findings.runs.to_dict("records")]
    return {
        "title": sources.title,
        "protocol": findings.protocol,
        "metrics": [_metric(metric) for metric in METRICS],
        "curveMetrics": [metric.key for metric in CURVE_METRICS],
        "costs": COSTS,
        "rows": [_row(row, sources) for row in findings.rows],
        "scenes": list(findings.scenes),
        "whyPaper": WHY_THE_PAPER_DIFFERS,
        "configurations": configurations.entries,
        "machines": machines.entries,
        "runs": runs,
        **({} if sources.live is None else {"live": {"key": sources.live.key, "every": sources.live.every}}),
    }


class _Once:
    """What many runs have alike, told once; a run names it by its place."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self._places: dict[str, int] = {}

    def place(self, entry: dict[str, Any]) -> int | None:
        """Place of an entry among all of them; None for an empty one."""
        if not entry:
            return None
        key = json.dumps(entry, sort_keys=True)
        if key not in self._places:
            self._places[key] = len(self.entries)
            self.entries.append(entry)
        return self._places[key]


def _metric(metric: Metric) -> dict[str, Any]:
    return {
        "key": metric.key,
        "group": metric.group,
        "label": metric.label,
        "title": metric.title,
        "higher": metric.higher_is_better,
        "digits": metric.digits,
        "headline": is_headline(metric),
        "definition": definition(metric),
    }


def _row(row: str, sources: Sources) -> dict[str, Any]:
    findings, texts = sources.findings, sources.rows.get(row, RowTexts())
    paper, mine = findings.counterparts.get(row), findings.runs[findings.runs["row"] == row]
    return {
        "name": row,
        "note": texts.note,
        "bound": BOUNDS.get(row),
        "truth": bool(mine["sees_truth"].eq(True).any()),
        "paper": paper and {"method": paper.method, "values": paper.values},
        "command": shlex.join(["python", "-m", "ia_bench", *texts.overrides]) if texts.overrides else "",
    }


def _run(run: dict[str, Any], page: Path, of: Findings, configurations: _Once, machines: _Once) -> dict[str, Any]:
    found = evidence_of(run)
    machine = {**{key: run[key] for key in ("commit", "cpu", "threads") if not pd.isna(run[key])}, **found.get("environment", {})}
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
        "command": found.get("command"),
        "configuration": configurations.place(found.get("settings", {})),
        "machine": machines.place(machine),
        "files": found.get("files"),
        "renderer": found.get("renderer"),
        "curve": None if run["curve"] is None else curve_data(run["curve"]),
    }
    return {key: value for key, value in record.items() if value is not None and value not in ({}, [], "")}


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


def _bounds(block: Block) -> dict[str, tuple[float, float]]:
    """Metric key -> floor and ceiling, where the block has both and they differ."""
    of = {BOUNDS[one.row]: one for one in block.lines if one.row in BOUNDS}
    found = {}
    for metric in METRICS:
        ends = [of[name].values[metric.key] if name in of else None for name in ("floor", "ceiling")]
        means = [end.mean for end in ends if end is not None]
        if len(means) == 2 and means[0] != means[1]:
            found[metric.key] = (means[0], means[1])
    return found


def _numbers(one: Line, block: Block, bounds: Mapping[str, tuple[float, float]]) -> Sequence[Number]:
    numbers = []
    for metric in METRICS:
        value = one.values[metric.key]
        text, _, width = estimate_text(value, metric, block.scenes).partition(" ± ")
        numbers.append(
            Number(
                key=metric.key,
                text=text,
                width=width,
                value=_value(None if value is None else value.mean),
                share=_share(value, bounds.get(metric.key)),
                best=block.is_best(one.row, metric),
                why="; ".join(one.reasons[metric.key]),
                headline=is_headline(metric),
            )
        )
    seconds, memory = None if one.seconds is None else one.seconds.mean, one.peak_memory_bytes
    return [
        *numbers,
        Number("seconds", "–" if seconds is None else f"{seconds:.1f}", value=_value(seconds)),
        Number("memory", "–" if memory is None else f"{memory / 2**20:.0f}", value=_value(memory), headline=False),
        Number("failed", f"{one.failed}/{one.runs}", value=str(one.failed)),
    ]


def _value(number: float | None) -> str:
    return "" if number is None else repr(short(number))


def _share(value: Estimate | None, bounds: tuple[float, float] | None) -> float | None:
    if value is None or bounds is None:
        return None
    floor, ceiling = bounds
    return round(100 * min(max((value.mean - floor) / (ceiling - floor), 0.0), 1.0), 1)
