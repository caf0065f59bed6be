"""What a prior is worth: how much a row gains over the reference row of the same capture, and how many photographs that saves.

Intervals are those of a bootstrap of two levels: scenes are drawn again, and of each scene that is drawn its seeds. What a gain is
at equal seconds is in :mod:`ia_bench.report.seconds`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, product
from operator import itemgetter

import numpy as np
from scipy.stats import t as student

from ia_bench.report.collect import Record, Runs
from ia_bench.report.seconds import NOTHING_LEFT_OUT, WORTH_METRICS
from ia_bench.report.statistics import CONFIDENCE, Judged, Paired, ScoresByCell, better, half_width, judged, means, side_by_side
from ia_bench.report.table import BOUNDS, carried_text, p_text, signs_text
from ia_bench.runs.table import Row, Table, capture_of, crossed_name
from ia_bench.scores.metrics import METRIC_OF, METRICS, Metric

REPLICATES = 10_000
POWER = 0.8
"""With this probability an effect of the size :attr:`Gain.detectable` would have been found."""
SHOWN = (*WORTH_METRICS, METRIC_OF["roughness.mse"])
"""Metrics of the maps."""


def replicates(scenes: Sequence[np.ndarray], count: int = REPLICATES) -> np.ndarray:
    """Means of ``count`` resampled experiments, (count, ...).

    Every replicate draws as many scenes as there are, with replacement, and for each of them as many of its seeds, with
    replacement; its value is the mean over scenes of the means over seeds. One seed a scene leaves the scenes alone to vary.
    ``scenes``: one array (seeds, ...) for each scene; what follows the seeds stays together, so that values of one run are drawn
    together.
    """
    generator = np.random.default_rng(0)
    values = [np.asarray(scene, np.float64) for scene in scenes]
    chosen = generator.integers(len(values), size=(count, len(values)))
    total = np.zeros((count, *values[0].shape[1:]))
    for place in range(len(values)):
        for index, scene in enumerate(values):
            mine = np.flatnonzero(chosen[:, place] == index)
            seeds = generator.integers(len(scene), size=(len(mine), len(scene)))
            total[mine] += scene[seeds].mean(axis=1)
    return total / len(values)


def interval(drawn: np.ndarray) -> tuple[float, float]:
    """The middle 95 % of replicates (count,), some of which may be infinite."""
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], method="inverted_cdf")
    return float(low), float(high)


@dataclass(frozen=True)
class Gain(Judged):
    """A row against the reference row, under one capture and in one metric; positive is better in every metric."""

    row: str  # the row, without its capture
    reference: str  # the row that it is compared with, without its capture
    capture: str  # the label of how the scenes were photographed
    scenes: int  # that the row or the reference has
    beside: float  # mean of the reference over the same scenes and seeds
    level: float  # mean of the reference over all scenes and seeds that it was run with under this capture; the same for every row

    @cached_property
    def mean(self) -> float:
        """The mean gain: over scenes, of each scene's mean over seeds."""
        return float(self.pairs.scenes.mean())

    @cached_property
    def bootstrap(self) -> tuple[float, float] | None:
        """The interval by the bootstrap over scenes and seeds; None for a single scene."""
        return interval(replicates(self.pairs.seeds)) if len(self.pairs.pairs) > 1 else None

    @property
    def detectable(self) -> float | None:
        """The smallest true gain that would have been decided alone with probability .8; among several it takes more.

        (t(.975) + t(.8)) s / sqrt(n) for n scenes whose means have the standard deviation s; None for a single scene.
        """
        scenes = self.pairs.scenes
        if len(scenes) < 2:
            return None
        quantiles = student.ppf([0.5 + CONFIDENCE / 2, POWER], len(scenes) - 1)
        return float(quantiles.sum() * np.std(scenes, ddof=1) / math.sqrt(len(scenes)))

    @property
    def outcome(self) -> str:
        """What is decided among all gains in this metric, in a word."""
        return "undecided" if not self.survives else "gains" if self.mean > 0 else "costs"

    @property
    def text(self) -> str:
        """The mean with its sign."""
        return f"{self.mean:+.{self.metric.digits}f}"

    @property
    def between(self) -> str:
        """The bootstrap's interval; empty for a single scene."""
        return "" if self.bootstrap is None else " to ".join(f"{end:+.{self.metric.digits}f}" for end in self.bootstrap)

    @property
    def told(self) -> str:
        """What else there is to know of it, in a sentence."""
        row, over = (crossed_name(name, self.capture) for name in (self.row, self.reference))
        text, width = self.metric.text, half_width(self.pairs.scenes)
        known = [
            f"{row}: {self.text}{' dB' if self.metric.label == 'PSNR' else ''} over {over}, which has {text(self.beside)}",
            f"{self.outcome}{', decided alone' if self.alone else ''}",
            self.p_value is not None and f"p = {p_text(self.p_value)}",
            f"scenes: {len(self.pairs.pairs)}, pairs of runs: {self.pairs.count}",
            self.pairs.signs and f"above zero in {signs_text(self.pairs)}",
            width is not None and f"over other scenes ± {text(width)}",
            self.pairs.new_scene is not None and f"one more scene ± {text(self.pairs.new_scene)}",
            self.detectable is not None and f"would have been decided alone from {text(self.detectable)}",
            self.pairs.carriers and f"carried by {carried_text(self.pairs)}",
        ]
        return "; ".join(words for words in known if words) + "."


@dataclass(frozen=True)
class Map:
    """What every row is worth in one metric: ``lines`` of captures, columns of ``rows`` without their captures.

    A line has the label of a capture, the level of the reference under it, and the gain of every row; None: not run.
    """

    metric: Metric
    reference: str
    rows: tuple[str, ...]
    lines: tuple[tuple[str, float, tuple[Gain | None, ...]], ...]

    @property
    def largest(self) -> float:
        """The largest mean gain or loss."""
        return max(abs(gain.mean) for *_, some in self.lines for gain in some if gain is not None)


def gains(runs: Runs, table: Table) -> list[Gain]:
    """Every row of a table against its reference, capture by capture; what has no pair of runs is left out.

    Nothing of a table whose scenes are photographed in one way, or that has no reference.
    """
    if table.reference is None or not table.captures:
        return []
    tables = {metric: (side_by_side(runs, metric.column), means(runs, metric.column)) for metric in METRICS}
    found = []
    for label, row, metric in product([capture_of(one).label for one in table.captures], _compared(table), METRICS):
        (scores, levels), reference = tables[metric], crossed_name(table.reference, label)
        pairs, level = better(scores, crossed_name(row.name, label), reference, metric), levels.get(reference)
        if pairs.pairs and level is not None:
            theirs = scores[reference]
            beside = Paired.of({(scene, seed): theirs[scene, seed] for scene, seeds in pairs.pairs.items() for seed in seeds})
            scenes = len({scene for scene, _ in (*theirs, *scores[crossed_name(row.name, label)])})  # either may have failed
            complete, mean = len(pairs.pairs) == scenes, float(beside.scenes.mean())
            found.append(Gain(metric, pairs, complete, row.name, table.reference, label, scenes, mean, level.mean))
    families = {metric: iter(judged([gain for gain in found if gain.metric == metric])) for metric in METRICS}
    return [next(families[gain.metric]) for gain in found]


def maps(found: Sequence[Gain]) -> list[Map]:
    """The gains in each metric of SHOWN as a map, where there are any."""
    made = []
    for metric in SHOWN:
        cells = {(gain.capture, gain.row): gain for gain in found if gain.metric == metric}
        rows = tuple(dict.fromkeys(row for _, row in cells))
        levels = {gain.capture: gain.level for gain in cells.values()}
        lines = tuple(
            (label or NOTHING_LEFT_OUT, level, tuple(cells.get((label, row)) for row in rows)) for label, level in levels.items()
        )
        made += [Map(metric, found[0].reference, rows, lines)] if cells else []
    return made


def _compared(table: Table) -> list[Row]:
    """The rows that are compared with the reference: all but itself, ground truth and one grey."""
    bounds = {*BOUNDS, *(f"method={bound}" for bound in BOUNDS)}
    return [row for row in table.rows if row.name != table.reference and bounds.isdisjoint((row.name, *row.overrides))]


def worth(runs: Runs, table: Table) -> list[Record]:
    """How many photographs the reference needs to be where a row is, for every other row and every number of photographs it has.

    Captures that differ in nothing but that number are a family, ``capture`` in the records: "" or "LDR", say. Those scenes and
    seeds count that have the reference with all numbers of the family, and the row with the one in question: ``scenes``, and
    ``pairs`` of runs. What fitted all photographs had as many as its runs say, the most where scenes differ. ``needed`` is by
    linear interpolation in the logarithm of the number; infinite where the reference does not get there with all, 0 where its
    fewest are better; ``low`` and ``high`` by the bootstrap over scenes and seeds, None for a single scene.
    """
    captures = list(map(capture_of, table.captures))
    whole = [crossed_name(row.name, one.label) for row in table.rows for one in captures if one.views == "all"]
    known = runs.loc[runs["row"].isin(whole), "photographs"].dropna()
    every = int(known.max()) if len(known) else table.photographs
    families: dict[str, dict[int, str]] = {}
    for capture in captures:
        families.setdefault(capture.others, {})[every if capture.views == "all" else int(capture.views)] = capture.label
    scores = {metric: side_by_side(runs, metric.column) for metric in WORTH_METRICS}
    found = []
    for others, labels in families.items():
        curve = sorted(labels)
        references = [crossed_name(str(table.reference), labels[count]) for count in curve]
        for row, metric, count in product(_compared(table) if len(curve) > 1 else [], WORTH_METRICS, curve):
            scenes = _together(scores[metric], [*references, crossed_name(row.name, labels[count])])
            if scenes and (row.captures is None or labels[count] in row.captures):
                mean = np.mean([seeds.mean(axis=0) for seeds in scenes], axis=0)[None]
                low, high = interval(_needed(replicates(scenes), curve)) if len(scenes) > 1 else (None, None)
                one = {"row": row.name, "capture": others, "metric": metric.key, "photographs": count}
                bounds = {"needed": float(_needed(mean, curve)[0]), "low": low, "high": high}
                found.append({**one, **bounds, "scenes": len(scenes), "pairs": sum(map(len, scenes))})
    return found


def _together(scores: ScoresByCell, rows: Sequence[str]) -> list[np.ndarray]:
    """One array (seeds, rows) for every scene, of the seeds that all rows have."""
    cells = [cell for cell in scores.get(rows[0], {}) if all(cell in scores.get(row, {}) for row in rows)]
    return [np.array([[scores[row][cell] for row in rows] for cell in some]) for _, some in groupby(cells, key=itemgetter(0))]


def _needed(values: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """Photographs that the reference needs in each experiment of ``values`` (experiments, ``counts`` and one).

    The last column is the row's, those before it are the reference's. More photographs count as never worse: its curve is the
    running best.
    """
    curves, level, each = np.maximum.accumulate(values[:, :-1], axis=1), values[:, -1], np.arange(len(values))
    first = (curves < level[:, None]).sum(axis=1)  # of the reference's that is no worse
    below, above = np.clip(first - 1, 0, None), np.clip(first, None, len(counts) - 1)
    low, high = curves[each, below], curves[each, above]
    part = np.divide(level - low, high - low, out=np.zeros(len(values)), where=high > low)
    logs = np.log2(counts)
    found = np.exp2(logs[below] + part * (logs[above] - logs[below]))
    return np.where(level > curves[:, -1], np.inf, np.where(level < curves[:, 0], 0.0, found))
