"""What the page says: the numbers for its templates, and the same as data for its scripts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.report.collect import BOUNDS, Curve, Run
from ia_bench.report.findings import Findings
from ia_bench.report.site.against import Changes
from ia_bench.report.site.definitions import COSTS, WHY_THE_PAPER_DIFFERS, definition
from ia_bench.report.site.evidence import Commands, Evidence, Settings, common, evidence_of
from ia_bench.report.site.leaders import Leader, leaders
from ia_bench.report.site.worth import Map
from ia_bench.report.statistics import Estimate, Line, best_rows
from ia_bench.report.table import HEADLINE, Block, estimate_text
from ia_bench.scores.columns import CURVE_METRICS, METRICS, Metric

MEAN = "mean over scenes"
DIGITS = 5  # significant ones of a number that a script draws or sorts by
EXACT = 7  # those of a number that a script prints, so that it rounds as the table does
BRIEF = 0.05  # seconds below which a phase is not told
OF_A_RUN = ("seed", "scene.name")  # settings that every run tells by itself


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
        changes: What is different from a former report, None where there is none.
        live: What a page that is watched has to know, None for a report.
        worth: Maps of what rows are worth, where scenes were photographed in several ways.
    """

    findings: Findings
    title: str
    rows: Mapping[str, RowTexts] = field(default_factory=dict)
    changes: Changes | None = None
    live: Live | None = None
    worth: Sequence[Map] = ()


@dataclass(frozen=True)
class Number:
    """One entry of the table.

    Attributes:
        key: Of the metric or the cost.
        text: The mean as it is printed, – where there is none.
        width: The interval's half width as it is printed, empty where there is none.
        value: What the entry is sorted by, empty where there is none.
        share: How much of the way from floor to ceiling it goes, in percent; None where that is not known.
        best: Whether it is the best of those that do not see the truth.
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
    """The table over one scene, or over all: its leaders, and a line of numbers for every row."""

    name: str
    leaders: tuple[Leader, ...]
    lines: tuple[tuple[Line, tuple[Number, ...]], ...]


def scopes(findings: Findings) -> list[Scope]:
    """The mean over scenes, where there are several, then every scene."""
    blocks = [*([findings.overall] if len(findings.scenes) > 1 else []), *findings.blocks]
    shown = [metric for metric in METRICS if is_headline(metric)]
    found = []
    for block in blocks:
        runs = [run for run in findings.runs if block.title in (run.scene, MEAN)]
        best = {metric.key: best_rows(block.lines, metric, block.scenes) for metric in METRICS}
        bounds = _bounds(block)
        lines = tuple((one, tuple(_numbers(one, block, best, bounds))) for one in block.lines)
        found.append(Scope(block.title, tuple(leaders(runs, block, shown)), lines))
    return found


def is_headline(metric: Metric) -> bool:
    """Whether a metric is one of those that a table is read by first."""
    return metric.label in HEADLINE


def data(sources: Sources, page: Path) -> dict[str, Any]:
    """Everything that the page's scripts need, as JSON types. ``page``: the folder that links to run folders start from."""
    findings = sources.findings
    evidence = [evidence_of(run) for run in findings.runs]
    shared = common(one.settings for one in evidence if one.settings)
    machines = common(one.environment for one in evidence if one.environment)
    commands = Commands({row: texts.overrides for row, texts in sources.rows.items()})
    known = _Told(commands, shared, machines)
    runs = [_run(run, one, known, page, findings) for run, one in zip(findings.runs, evidence, strict=True)]
    return {
        "title": sources.title,
        "protocol": findings.protocol,
        "metrics": [_metric(metric) for metric in METRICS],
        "curveMetrics": [metric.key for metric in CURVE_METRICS],
        "costs": COSTS,
        "rows": [_row(row, sources) for row in findings.rows],
        "scenes": list(findings.scenes),
        "whyPaper": WHY_THE_PAPER_DIFFERS,
        "settings": shared,
        "environment": machines,
        "commands": known.commands,
        "configurations": known.configurations,
        "runs": runs,
        **({} if sources.live is None else {"live": {"key": sources.live.key, "every": sources.live.every}}),
    }


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
    paper = findings.counterparts.get(row)
    return {
        "name": row,
        "note": texts.note,
        "bound": BOUNDS.get(row),
        "truth": any(run.sees_truth for run in findings.runs if run.row == row),
        "paper": paper and {"method": paper.method, "values": paper.values},
    }


class _Told:
    """What many runs have alike, told once; a run names it by its place."""

    def __init__(self, commands: Commands, settings: Settings, machine: Settings) -> None:
        self.machine = machine
        self.commands: list[Any] = []
        self.configurations: list[Any] = []
        self._writer, self._settings = commands, settings

    def command(self, run: Run, found: Evidence) -> int | None:
        """Place of the command among all of them."""
        command = self._writer.of(run, found.settings, found.given)
        return None if command is None else _place(self.commands, list(command))

    def configuration(self, found: Evidence) -> int | None:
        """Place of how a configuration differs from what most runs have: names it lacks, and its own values."""
        if not found.settings:
            return None
        own = {name: value for name, value in found.settings.items() if name not in OF_A_RUN}
        absent = [name for name in self._settings if name not in found.settings]
        differs = {name: value for name, value in own.items() if name not in self._settings or self._settings[name] != value}
        return _place(self.configurations, [absent, differs])


def _place(known: list[Any], entry: Any) -> int:  # noqa: ANN401 (any JSON value)
    if entry not in known:
        known.append(entry)
    return known.index(entry)


def _run(run: Run, found: Evidence, told: _Told, page: Path, of: Findings) -> dict[str, Any]:
    """One run; of its settings and its machine only what most runs do not have alike."""
    machine = {**{key: run.about[key] for key in ("commit", "cpu") if run.about.get(key)}, **found.environment}
    record = {
        "row": of.rows.index(run.row),
        "scene": of.scenes.index(run.scene),
        "seed": run.seed,
        "problem": run.problem,
        "values": [short(run.metrics.get(metric.key), EXACT) for metric in METRICS],
        "reasons": {key: run.reason(key) for key, value in run.metrics.items() if value is None},
        "seconds": short(run.seconds),
        "phases": {name: round(seconds, 1) for name, seconds in run.phases.items() if seconds >= BRIEF},
        "memory": run.peak_memory_bytes,
        "hash": run.about.get("config_hash"),
        "folder": os.path.relpath(run.folder, page).replace(os.sep, "/") if found.settings else None,
        "command": told.command(run, found),
        "configuration": told.configuration(found),
        "environment": {name: value for name, value in machine.items() if told.machine.get(name) != value},
        "files": found.files,
        "renderer": found.renderer,
        "curve": None if run.curve is None else curve_data(run.curve),
    }
    return {key: value for key, value in record.items() if value is not None and value not in ({}, [], "")}


def curve_data(curve: Curve) -> dict[str, Any]:
    """A curve as the page's scripts have it."""
    return {
        "level": curve.is_level,
        "seconds": [short(value) for value in curve.seconds.tolist()],
        "values": [
            [short(value) if np.isfinite(value) else None for value in curve.values[metric.column].tolist()]
            for metric in CURVE_METRICS
        ],
    }


def short(value: float | None, digits: int = DIGITS) -> float | None:
    """A number without the digits that nobody sees."""
    return None if value is None else float(f"{value:.{digits}g}")


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


def _numbers(one: Line, block: Block, best: Mapping[str, set[str]], bounds: Mapping[str, tuple[float, float]]) -> Sequence[Number]:
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
                best=one.row in best[metric.key],
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
