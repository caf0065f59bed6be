"""What a prior is worth, for the page: a map of gains, photographs by radiometry and geometry, for every row and metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.report.collect import Run
from ia_bench.report.table import carried_text
from ia_bench.report.value.gains import Gain, gains, in_words
from ia_bench.report.value.heat_map import SHOWN
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.table import Row, Table, capture_of, crossed_name
from ia_bench.scores.columns import Metric

REFERENCE = "none"
"""The row that others are compared with where nobody says otherwise."""


@dataclass(frozen=True)
class MapCell:
    """One cell of a map, ready to be printed.

    Attributes:
        row: Its row of the table, capture included.
        reference: The row that it is compared with.
        text: The mean gain, with its sign.
        between: Its interval, empty for a single scene.
        side: "gains" or "costs" where that is decided, else "undecided".
        worse: Whether the mean is below zero.
        strength: The mean as a share of the largest one of its metric, in percent.
        tip: What else there is to know.
        scenes: Those that it is the mean of.
    """

    row: str
    reference: str
    text: str
    between: str
    side: str
    worse: bool
    strength: int
    tip: str
    scenes: tuple[str, ...]


@dataclass(frozen=True)
class Map:
    """The gains of one row in one metric: lines of photographs, columns of all else that a capture leaves out; None: not run.

    ``reference``: over which row, without its capture.
    """

    row: str
    reference: str
    metric: Metric
    columns: tuple[str, ...]
    lines: tuple[tuple[str, tuple[MapCell | None, ...]], ...]


def maps(runs: Sequence[Run], table: Table, reference: str | None = None) -> list[Map]:
    """The maps of a table whose scenes are photographed in several ways, or of runs whose captures differ; else none.

    ``reference``: the row that others are compared with where the table does not say.
    """
    if not table.captures or table.reference is None:
        found = table_of(runs, reference or table.reference or REFERENCE)
        if found is None:
            return []
        table = found
    shown = [gain for gain in gains(runs, table) if gain.metric.key in SHOWN]
    largest = {key: max((abs(gain.over_scenes.mean) for gain in shown if gain.metric.key == key), default=0.0) for key in SHOWN}
    made = []
    for key in SHOWN:
        mine = [gain for gain in shown if gain.metric.key == key]
        for row in dict.fromkeys(gain.row for gain in mine):
            made.append(_map(row, [gain for gain in mine if gain.row == row], table, largest[key]))
    return made


def table_of(runs: Sequence[Run], reference: str) -> Table | None:
    """A table of runs that were made one by one, from what their folders say of the capture; None where all have the same.

    A row's name ends with its capture, as it does where nobody gave it a name.
    """
    captures: dict[str, dict[str, Any]] = {}
    rows: dict[str, None] = {}
    most = 0
    for run in runs:
        settings = _capture(run)
        if settings is None:
            continue
        label = capture_of(settings).label
        captures[label] = settings
        rows[run.row.removesuffix(f", {label}") if label else run.row] = None
        most = max(most, run.photographs or 0)
    if len(captures) < 2 or reference not in rows:
        return None
    return Table(rows=[Row(name, []) for name in rows], reference=reference, captures=[*captures.values()], photographs=most)


def _capture(run: Run) -> dict[str, Any] | None:
    """The settings of a run's capture that are not the usual ones; None where its folder does not say."""
    try:
        record = read_json(run.folder / CONFIG)
        found: dict[str, Any] = record["config"].get("capture", {})
    except (InputError, KeyError):
        return None
    plain = CaptureSettings()
    changed = {key: value for key, value in found.items() if hasattr(plain, key) and value != getattr(plain, key)}
    name = record.get("given", {}).get("capture.name")  # by which its label calls it
    return changed if name is None else {**changed, "name": name}


def _map(row: str, mine: Sequence[Gain], table: Table, largest: float) -> Map:
    others = list(dict.fromkeys(gain.capture.others for gain in mine))
    others.sort(key=lambda label: label != "")  # nothing left out stands first, the rest as it came
    counts = sorted({gain.photographs for gain in mine}, reverse=True)
    cells = {(gain.photographs, gain.capture.others): _worth(gain, table, largest) for gain in mine}
    lines = tuple((_count(number), tuple(cells.get((number, other)) for other in others)) for number in counts)
    return Map(row, str(table.reference), mine[0].metric, tuple(map(in_words, others)), lines)


def _worth(gain: Gain, table: Table, largest: float) -> MapCell:
    metric, estimate, drawn = gain.metric, gain.over_scenes, gain.bootstrap
    label = gain.capture.label
    reference = crossed_name(str(table.reference), label)
    seeds = sum(map(len, gain.pairs.pairs.values()))
    found = f"{estimate.mean:+.{metric.digits}f}{' dB' if metric.label == 'PSNR' else ''}"
    made_of = f"{_count_of(len(gain.pairs.pairs), 'scene')}, {_count_of(seeds, 'pair')} of runs"
    tip = [
        f"{crossed_name(gain.row, label)}: {found} over {reference}, which has {metric.text(gain.reference)}",
        f"{gain.outcome}{'' if drawn else ', since there is one scene'}: {made_of}",
    ]
    if estimate.half_width is not None:
        tip.append(f"over other scenes ± {metric.text(estimate.half_width)}")
    if gain.detectable is not None:
        tip.append(f"would have been decided from {metric.text(gain.detectable)}")
    if gain.headroom is not None:
        tip.append(f"{100 * gain.headroom:.0f} % of the way to the ceiling")
    if gain.pairs.carriers:
        tip.append(f"carried by {carried_text(gain.pairs)}")
    return MapCell(
        row=crossed_name(gain.row, label),
        reference=reference,
        text=f"{estimate.mean:+.{metric.digits}f}",
        between="" if drawn is None else f"{drawn.low:+.{metric.digits}f} to {drawn.high:+.{metric.digits}f}",
        side=gain.outcome,
        worse=estimate.mean < 0,
        strength=round(100 * abs(estimate.mean) / largest) if largest else 0,
        tip="; ".join(tip) + ".",
        scenes=tuple(gain.pairs.pairs),
    )


def _count(number: int) -> str:
    return _count_of(number, "photograph")


def _count_of(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
