"""By how much a row beats the reference row of the same capture, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from ia_bench.capture.settings import CaptureSettings
from ia_bench.report.collect import BOUNDS, Run
from ia_bench.report.statistics import CONFIDENCE, Estimate, Paired, line, paired
from ia_bench.report.value.bootstrap import Interval, interval, replicates
from ia_bench.runs.table import Row, Table, capture_of, crossed_name
from ia_bench.scores.columns import METRICS, Metric

POWER = 0.8
"""With this probability an effect of the size :attr:`Gain.detectable` would have been found."""


@dataclass(frozen=True)
class Gain:
    """A row against the reference row, under one capture and in one metric; positive is better in every metric.

    Attributes:
        row: The row, without its capture.
        capture: How the scenes were photographed.
        photographs: How many of them there were.
        metric: In which it is compared.
        pairs: Its differences to the reference, turned so that more is better, by scene and seed.
        reference: Mean of the reference over the same scenes and seeds.
        level: Mean of the reference over all scenes and seeds that it was run with under this capture; the same for every row.
        headroom: The part of what the ceiling is above the reference that the row closes; None where no ceiling was run.
    """

    row: str
    capture: CaptureSettings
    photographs: int
    metric: Metric
    pairs: Paired
    reference: float
    level: float
    headroom: float | None

    @property
    def outcome(self) -> str:
        """What is decided, in a word."""
        return {1: "gains", -1: "costs", 0: "undecided"}[self.side]

    @property
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
        means = [float(np.mean(list(seeds.values()))) for seeds in self.pairs.pairs.values()]
        if len(means) < 2:
            return None
        quantiles = student.ppf([0.5 + CONFIDENCE / 2, POWER], len(means) - 1)
        return float(quantiles.sum() * np.std(means, ddof=1) / math.sqrt(len(means)))

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


def gains(runs: Sequence[Run], table: Table) -> list[Gain]:
    """Every row of ``table`` against its reference, capture by capture; what has no pair of runs is left out.

    Raises ValueError for a table without a reference.
    """
    table = with_photographs(table, runs)
    if table.reference is None:
        raise ValueError("expected a table with a reference, found none")
    ceiling = next((row.name for row in table.rows if _is(row, "ceiling")), None)
    found = []
    for settings in table.captures or [{}]:
        capture = capture_of(settings)
        reference = crossed_name(table.reference, capture.label)
        levels = line(runs, reference).values
        for row in (row.name for row in compared(table)):
            for metric in METRICS:
                pairs, level = _better(runs, crossed_name(row, capture.label), reference, metric), levels[metric.key]
                if pairs.pairs and level is not None:
                    own = _mean_of(runs, reference, metric, pairs)
                    share = None if ceiling is None else _share(pairs, _better(runs, ceiling, reference, metric))
                    found.append(Gain(row, capture, photographs_of(capture, table), metric, pairs, own, level.mean, share))
    return found


def with_photographs(table: Table, runs: Sequence[Run]) -> Table:
    """The table with as many photographs a scene as its runs say that fitted all of them; the most where scenes differ."""
    whole = [capture_of(settings) for settings in table.captures or [{}]]
    labels = [capture.label for capture in whole if capture.views == "all"]
    rows = {crossed_name(row.name, label) for row in table.rows for label in labels}
    most = max((run.photographs or 0 for run in runs if run.row in rows), default=0)
    return replace(table, photographs=most) if most else table


def photographs_of(capture: CaptureSettings, table: Table) -> int:
    """How many photographs a capture of the table's scenes takes."""
    return table.photographs if capture.views == "all" else int(capture.views)


def in_words(others: str) -> str:
    """What a capture leaves out beside photographs, as maps call it."""
    return others or "HDR, mesh given"


def compared(table: Table) -> list[Row]:
    """The rows that are compared with the reference: all but itself, ground truth and one grey."""
    return [row for row in table.rows if row.name != table.reference and not any(_is(row, bound) for bound in BOUNDS)]


def _is(row: Row, method: str) -> bool:
    """Whether a row is that of a method that optimises nothing; a row that was made of runs has a name alone."""
    return row.name == method or f"method={method}" in row.overrides


def _better(runs: Sequence[Run], row: str, reference: str, metric: Metric) -> Paired:
    """The differences, more being better."""
    return paired(runs, row, reference, metric) if metric.higher_is_better else paired(runs, reference, row, metric)


def _mean_of(runs: Sequence[Run], row: str, metric: Metric, pairs: Paired) -> float:
    """The mean of a row over scenes, over the seeds of ``pairs``."""
    values = {(run.scene, run.seed): run.metrics[metric.key] for run in runs if run.row == row and run.problem is None}
    return float(np.mean([np.mean([values[scene, seed] for seed in seeds]) for scene, seeds in pairs.pairs.items()]))


def _share(gained: Paired, possible: Paired) -> float | None:
    """Mean gain over mean headroom, of the scenes that have both; a ceiling is the same for all seeds."""
    scenes = gained.pairs.keys() & possible.pairs.keys()
    if not scenes:
        return None
    ours, most = (np.mean([np.mean(list(pairs.pairs[scene].values())) for scene in scenes]) for pairs in (gained, possible))
    return float(ours / most) if most > 0 else None
