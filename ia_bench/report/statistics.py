"""Means and 95 % intervals over seeds and scenes. Failed runs enter no mean; they are counted.

Seeds are repetitions: a scene's value is the mean over its seeds, with Student's t interval. Scenes are not: the
overall value is the plain mean of the scenes' means, and its interval tells how much *other seeds on the same scenes*
would move it (Welch-Satterthwaite). To compare two rows, their scenes and seeds are paired (:class:`Paired`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ia_bench.report.collect import Run
from ia_bench.scores.columns import METRIC_OF, METRICS, Metric

CONFIDENCE = 0.95
RENDERED = ("View synthesis", "Relighting")  # groups of metrics that depend on who renders


@dataclass(frozen=True)
class Estimate:
    """``mean`` over ``scenes`` scenes, plus or minus ``half_width`` (95 %), None where nothing was repeated."""

    mean: float
    half_width: float | None
    scenes: int = 1


@dataclass(frozen=True)
class Line:
    """One row of a table, over one scene or over all.

    Attributes:
        row: Its name.
        sees_truth: Whether a run of it saw the ground truth.
        values: Metric key -> estimate, None where undefined.
        reasons: Metric key -> why finished runs have no value, each reason once.
        seconds: Mean over scenes and seeds.
        peak_memory_bytes: The largest of its runs.
        failed: Number of failed runs, of ``runs``.
        runs: Number of runs.
    """

    row: str
    sees_truth: bool
    values: dict[str, Estimate | None]
    reasons: dict[str, tuple[str, ...]]
    seconds: Estimate | None
    peak_memory_bytes: float | None
    failed: int
    runs: int


@dataclass(frozen=True)
class Redrawn:
    """A row whose renders are its own, and what the reference renderer makes of the textures and the light that it exports.

    Attributes:
        row: Its name.
        own: Metric key -> estimate of its own renders.
        reference: The same of the reference renderer's.
    """

    row: str
    own: dict[str, Estimate | None]
    reference: dict[str, Estimate | None]


@dataclass(frozen=True)
class Paired:
    """Differences of two rows in one metric: scene -> seed -> difference, of the seeds that both rows have."""

    pairs: dict[str, dict[int, float]]

    @property
    def over_seeds(self) -> Estimate | None:
        """The mean, with the interval within which other seeds on the same scenes would move it."""
        return over_scenes([list(seeds.values()) for seeds in self.pairs.values()])

    @property
    def over_scenes(self) -> Estimate | None:
        """The same mean, with Student's interval over scenes: whether the difference would hold on others of this kind."""
        estimate = over_seeds([float(np.mean(list(seeds.values()))) for seeds in self.pairs.values()])
        return estimate and Estimate(estimate.mean, estimate.half_width, len(self.pairs))

    @property
    def carriers(self) -> list[tuple[str, int]]:
        """The pairs (scene, seed) that carry the mean: without any one of them it is zero or has the other sign."""
        mean = self.over_seeds.mean if self.over_seeds else 0.0
        found = []
        for scene, seeds in self.pairs.items():
            for seed in seeds:
                without = {**self.pairs, scene: {other: value for other, value in seeds.items() if other != seed}}
                rest = over_scenes([list(values.values()) for values in without.values()])
                if mean and rest is not None and rest.mean * mean <= 0:
                    found.append((scene, seed))
        return found

    def of_scene(self, scene: str) -> Paired:
        """The pairs of one scene alone."""
        return Paired({scene: self.pairs[scene]} if scene in self.pairs else {})


def paired(runs: Sequence[Run], row: str, reference: str, metric: Metric) -> Paired:
    """Row minus reference wherever both have a value for the same scene and seed."""
    ours, theirs = ({(r.scene, r.seed): v for r, v in _values(runs, name, _metric_of(metric))} for name in (row, reference))
    pairs: dict[str, dict[int, float]] = {}
    for scene, seed in sorted(ours.keys() & theirs.keys()):
        pairs.setdefault(scene, {})[seed] = ours[scene, seed] - theirs[scene, seed]
    return Paired(pairs)


def over_seeds(values: Sequence[float]) -> Estimate | None:
    """Mean and Student's t interval of repetitions; None for no value."""
    return over_scenes([values]) if values else None


def over_scenes(values: Sequence[Sequence[float]]) -> Estimate | None:
    """Mean over scenes of the mean over each scene's seeds; scenes without a value are left out and not counted.

    The interval needs two seeds in every scene: standard error sqrt(sum s_i^2 / n_i) / S over S scenes, with Welch and
    Satterthwaite's degrees of freedom.
    """
    scenes = [np.asarray(seeds, dtype=np.float64) for seeds in values if len(seeds)]
    if not scenes:
        return None
    mean = float(np.mean([seeds.mean() for seeds in scenes]))
    if min(map(len, scenes)) < 2:
        return Estimate(mean, None, len(scenes))
    variances = np.array([seeds.var(ddof=1) / len(seeds) for seeds in scenes])
    total = variances.sum()
    if total == 0:
        return Estimate(mean, 0.0, len(scenes))
    freedom = total**2 / sum(v**2 / (len(seeds) - 1) for v, seeds in zip(variances, scenes, strict=True))
    half_width = float(student.ppf(0.5 + CONFIDENCE / 2, freedom)) * math.sqrt(total) / len(scenes)
    return Estimate(mean, half_width, len(scenes))


def line(runs: Sequence[Run], row: str) -> Line:
    """Summarise the runs of one row, over whichever scenes ``runs`` holds."""
    mine = [run for run in runs if run.row == row]
    done = [run for run in mine if run.problem is None]

    return Line(
        row=row,
        sees_truth=any(run.sees_truth for run in mine),
        values={metric.key: _mean(done, row, _metric_of(metric)) for metric in METRICS},
        reasons={m.key: tuple(dict.fromkeys(r.reason(m.key) for r in done if r.metrics[m.key] is None)) for m in METRICS},
        seconds=_mean(done, row, lambda run: run.seconds),
        peak_memory_bytes=max((run.peak_memory_bytes for run in done if run.peak_memory_bytes is not None), default=None),
        failed=len(mine) - len(done),
        runs=len(mine),
    )


def redrawn(runs: Sequence[Run], row: str) -> Redrawn | None:
    """What the reference renderer makes of a row in the metrics of renders; None for a row that it draws anyway."""
    keys = [metric.key for metric in METRICS if metric.group in RENDERED]
    reference = {key: _mean(runs, row, _variant_of(key.replace(".", "_reference."))) for key in keys}
    if not any(reference.values()):
        return None
    return Redrawn(row, {key: _mean(runs, row, _metric_of(METRIC_OF[key])) for key in keys}, reference)


def best_rows(lines: Sequence[Line], metric: Metric, scenes: int) -> set[str]:
    """Rows to print in bold: the best as printed, among those that do not see the truth and cover all ``scenes``."""
    ranked = {}
    for one in lines:
        value = one.values[metric.key]
        if value is not None and value.scenes == scenes and not one.sees_truth:
            ranked[one.row] = round(value.mean, metric.digits)
    best = (max if metric.higher_is_better else min)(ranked.values(), default=None)
    return {row for row, value in ranked.items() if value == best}


def _mean(runs: Sequence[Run], row: str, value: Callable[[Run], float | None]) -> Estimate | None:
    scenes: dict[str, list[float]] = {}
    for run, number in _values(runs, row, value):
        scenes.setdefault(run.scene, []).append(number)
    return over_scenes(list(scenes.values()))


def _variant_of(key: str) -> Callable[[Run], float | None]:
    return lambda run: run.variants.get(key)


def _metric_of(metric: Metric) -> Callable[[Run], float | None]:
    return lambda run: run.metrics[metric.key]


def _values(runs: Sequence[Run], row: str, value: Callable[[Run], float | None]) -> list[tuple[Run, float]]:
    """The finished runs of one row that have a value, with it."""
    mine = (run for run in runs if run.row == row and run.problem is None)
    return [(run, number) for run in mine if (number := value(run)) is not None]
