"""By how much a row beats the reference row of the same capture, and how sure that is: the map of what a prior is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from ia_bench.capture.settings import CaptureSettings
from ia_bench.report.bootstrap import Interval, interval, replicates
from ia_bench.report.collect import Runs
from ia_bench.report.statistics import CONFIDENCE, Estimate, Paired, better, means, side_by_side
from ia_bench.report.table import BOUNDS, carried_text
from ia_bench.runs.table import Row, Table, capture_of, crossed_name
from ia_bench.scores.columns import METRIC_OF, METRICS, Metric

POWER = 0.8
"""With this probability an effect of the size :attr:`Gain.detectable` would have been found."""
SHOWN = tuple(METRIC_OF[key] for key in ("aligned_albedo.psnr", "relighting.psnr", "roughness.mse"))
"""Metrics of the maps."""
NOTHING_LEFT_OUT = "all views"
"""What a capture without a label is called."""


@dataclass(frozen=True)
class Gain:
    """A row against the reference row, under one capture and in one metric; positive is better in every metric.

    Attributes:
        row: The row, without its capture.
        reference: The row that it is compared with, without its capture.
        capture: How the scenes were photographed.
        metric: In which it is compared.
        pairs: Its differences to the reference, turned so that more is better, by scene and seed.
        beside: Mean of the reference over the same scenes and seeds.
        level: Mean of the reference over all scenes and seeds that it was run with under this capture; the same for every row.
        headroom: The part of what the ceiling is above the reference that the row closes; None where no ceiling was run.
    """

    row: str
    reference: str
    capture: CaptureSettings
    metric: Metric
    pairs: Paired
    beside: float
    level: float
    headroom: float | None

    @property
    def outcome(self) -> str:
        """What is decided, in a word."""
        return {1: "gains", -1: "costs", 0: "undecided"}[self.side]

    @cached_property
    def over_scenes(self) -> Estimate:
        """Mean, with Student's interval over scenes."""
        estimate = self.pairs.over_scenes
        assert estimate is not None
        return estimate

    @cached_property
    def bootstrap(self) -> Interval | None:
        """The interval by the bootstrap over scenes and seeds; None for a single scene."""
        if len(self.pairs.pairs) < 2:
            return None
        return interval(replicates([np.array(list(seeds.values())) for seeds in self.pairs.pairs.values()]))

    @property
    def detectable(self) -> float | None:
        """The smallest true gain that would have been decided with probability .8, given how much scenes differ.

        (t(.975) + t(.8)) s / sqrt(n) for n scenes whose means have the standard deviation s; None for a single scene.
        """
        scenes = [float(np.mean(list(seeds.values()))) for seeds in self.pairs.pairs.values()]
        if len(scenes) < 2:
            return None
        quantiles = student.ppf([0.5 + CONFIDENCE / 2, POWER], len(scenes) - 1)
        return float(quantiles.sum() * np.std(scenes, ddof=1) / math.sqrt(len(scenes)))

    @property
    def side(self) -> int:
        """1: decided that it gains, -1: that it costs, 0: undecided.

        Decided where neither the bootstrap's interval nor Student's over scenes holds zero: with few scenes the first is narrow.
        """
        drawn, estimate = self.bootstrap, self.over_scenes
        if drawn is None or estimate.half_width is None:
            return 0
        across = Interval(estimate.mean - estimate.half_width, estimate.mean + estimate.half_width).side
        return drawn.side if drawn.side == across else 0

    @property
    def text(self) -> str:
        """The mean with its sign."""
        return f"{self.over_scenes.mean:+.{self.metric.digits}f}"

    @property
    def between(self) -> str:
        """The bootstrap's interval; empty for a single scene."""
        digits = self.metric.digits
        return "" if self.bootstrap is None else f"{self.bootstrap.low:+.{digits}f} to {self.bootstrap.high:+.{digits}f}"

    @property
    def told(self) -> str:
        """What else there is to know of it, in a sentence."""
        row, over = (crossed_name(name, self.capture.label) for name in (self.row, self.reference))
        unit = " dB" if self.metric.label == "PSNR" else ""
        text, width = self.metric.text, self.over_scenes.half_width
        known = [
            (True, f"{row}: {self.text}{unit} over {over}, which has {text(self.beside)}"),
            (True, f"{self.outcome}{'' if self.bootstrap else ', since there is one scene'}"),
            (True, f"scenes: {len(self.pairs.pairs)}, pairs of runs: {self.pairs.count}"),
            (width is not None, f"over other scenes ± {text(width or 0)}"),
            (self.detectable is not None, f"would have been decided from {text(self.detectable or 0)}"),
            (self.headroom is not None, f"{100 * (self.headroom or 0):.0f} % of the way to the ceiling"),
            (bool(self.pairs.carriers), f"carried by {carried_text(self.pairs)}"),
        ]
        return "; ".join(words for there, words in known if there) + "."


@dataclass(frozen=True)
class Map:
    """What every row is worth in one metric: lines of captures, columns of rows.

    Attributes:
        metric: Which one.
        reference: Over which row, without its capture.
        rows: The rows, without their captures.
        lines: Label of a capture, the level of the reference under it, and the gain of every row; None: not run.
    """

    metric: Metric
    reference: str
    rows: tuple[str, ...]
    lines: tuple[tuple[str, float, tuple[Gain | None, ...]], ...]

    @property
    def largest(self) -> float:
        """The largest mean gain or loss."""
        return max((abs(gain.over_scenes.mean) for *_, some in self.lines for gain in some if gain is not None), default=0.0)


def gains(runs: Runs, table: Table) -> list[Gain]:
    """Every row of a table against its reference, capture by capture; what has no pair of runs is left out.

    Nothing of a table whose scenes are photographed in one way, or that has no reference.
    """
    if table.reference is None or not table.captures:
        return []
    ceiling = next((row.name for row in table.rows if _is(row, "ceiling")), None)
    captures = [capture_of(settings) for settings in table.captures]
    rows = [row.name for row in compared(table)]
    found = {}
    for metric in METRICS:
        scores, levels = side_by_side(runs, metric), means(runs, metric.column)
        for capture in captures:
            reference = crossed_name(table.reference, capture.label)
            possible = Paired({}) if ceiling is None else better(scores, ceiling, reference, metric)
            for row in rows:
                pairs, level = better(scores, crossed_name(row, capture.label), reference, metric), levels.get(reference)
                if pairs.pairs and level is not None:
                    theirs = scores[reference]
                    beside = np.mean([np.mean([theirs[scene, seed] for seed in seeds]) for scene, seeds in pairs.pairs.items()])
                    gain = Gain(row, table.reference, capture, metric, pairs, float(beside), level.mean, _share(pairs, possible))
                    found[capture.label, row, metric.key] = gain
    keys = [(capture.label, row, metric.key) for capture in captures for row in rows for metric in METRICS]
    return [found[key] for key in keys if key in found]


def maps(found: Sequence[Gain]) -> list[Map]:
    """The gains in each metric of SHOWN as a map, where there are any."""
    made = []
    for metric in SHOWN:
        mine = [gain for gain in found if gain.metric == metric]
        cells = {(gain.capture.label, gain.row): gain for gain in mine}
        rows = tuple(dict.fromkeys(gain.row for gain in mine))
        levels = {gain.capture.label: gain.level for gain in mine}
        lines = tuple(
            (label or NOTHING_LEFT_OUT, level, tuple(cells.get((label, row)) for row in rows)) for label, level in levels.items()
        )
        made += [Map(metric, mine[0].reference, rows, lines)] if mine else []
    return made


def with_photographs(table: Table, runs: Runs) -> Table:
    """The table with as many photographs a scene as its runs say that fitted all of them; the most where scenes differ."""
    labels = [capture.label for capture in map(capture_of, table.captures) if capture.views == "all"]
    rows = [crossed_name(row.name, label) for row in table.rows for label in labels]
    known = runs.loc[runs["row"].isin(rows), "photographs"].dropna()
    return replace(table, photographs=int(known.max())) if len(known) else table


def compared(table: Table) -> list[Row]:
    """The rows that are compared with the reference: all but itself, ground truth and one grey."""
    return [row for row in table.rows if row.name != table.reference and not any(_is(row, bound) for bound in BOUNDS)]


def _is(row: Row, method: str) -> bool:
    """Whether a row is that of a method that optimises nothing."""
    return row.name == method or f"method={method}" in row.overrides


def _share(gained: Paired, possible: Paired) -> float | None:
    """Mean gain over mean headroom, of the scenes that have both; a ceiling is the same for all seeds."""
    scenes = gained.pairs.keys() & possible.pairs.keys()
    if not scenes:
        return None
    ours, most = (np.mean([np.mean(list(pairs.pairs[scene].values())) for scene in scenes]) for pairs in (gained, possible))
    return float(ours / most) if most > 0 else None
