"""Means and 95 % intervals over seeds and scenes. Failed runs enter no mean; they are counted.

Seeds are repetitions: a scene's value is the mean over its seeds, with Student's t interval. Scenes are not: the
overall value is the plain mean of the scenes' means, and its interval tells how much *other seeds on the same scenes*
would move it (Welch-Satterthwaite). To compare two rows, their scenes are paired (:func:`paired_difference`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ia_bench.report.collect import Run
from ia_bench.scores.columns import METRICS, Metric

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """``mean`` over ``scenes`` scenes, plus or minus ``half_width`` (95 %), None where nothing was repeated."""

    mean: float
    half_width: float | None
    scenes: int = 1


@dataclass(frozen=True)
class Line:
    """One row of a table, over one scene or over all: ``values`` by :attr:`Metric.key`, None where undefined.

    ``seconds`` is a mean, ``peak_memory_bytes`` the largest; ``failed`` of ``runs`` runs failed.
    """

    row: str
    sees_truth: bool
    values: dict[str, Estimate | None]
    seconds: Estimate | None
    peak_memory_bytes: float | None
    failed: int
    runs: int


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
    half_width = _t_quantile(freedom) * math.sqrt(total) / len(scenes)
    return Estimate(mean, half_width, len(scenes))


def paired_difference(runs: Sequence[Run], row: str, reference: str, metric: Metric) -> Estimate | None:
    """Mean over the scenes that both rows have of (row - reference), each the mean over its seeds.

    The interval is Student's over scenes: whether the difference would hold on other scenes of this kind.
    """
    theirs, ours = (_by_scene(runs, name, _metric_of(metric)) for name in (reference, row))
    shared = [scene for scene in ours if ours[scene] and theirs.get(scene)]
    differences = [float(np.mean(ours[scene]) - np.mean(theirs[scene])) for scene in shared]
    estimate = over_seeds(differences)
    return estimate and Estimate(estimate.mean, estimate.half_width, len(shared))


def line(runs: Sequence[Run], row: str) -> Line:
    """Summarise the runs of one row, over whichever scenes ``runs`` holds."""
    mine = [run for run in runs if run.row == row]
    done = [run for run in mine if run.problem is None]
    memory = [run.peak_memory_bytes for run in done if run.peak_memory_bytes is not None]

    def mean(value: Callable[[Run], float | None]) -> Estimate | None:
        return over_scenes(list(_by_scene(runs, row, value).values()))

    return Line(
        row=row,
        sees_truth=any(run.sees_truth for run in mine),
        values={metric.key: mean(_metric_of(metric)) for metric in METRICS},
        seconds=mean(lambda run: run.seconds),
        peak_memory_bytes=max(memory, default=None),
        failed=len(mine) - len(done),
        runs=len(mine),
    )


def best_rows(lines: Sequence[Line], metric: Metric, scenes: int) -> set[str]:
    """Rows to print in bold: the best as printed, among those that do not see the truth and cover all ``scenes``."""
    ranked = {}
    for one in lines:
        value = one.values[metric.key]
        if value is not None and value.scenes == scenes and not one.sees_truth:
            ranked[one.row] = round(value.mean, metric.digits)
    if not ranked:
        return set()
    best = (max if metric.higher_is_better else min)(ranked.values())
    return {row for row, value in ranked.items() if value == best}


def _metric_of(metric: Metric) -> Callable[[Run], float | None]:
    return lambda run: run.metrics[metric.key]


def _by_scene(runs: Sequence[Run], row: str, value: Callable[[Run], float | None]) -> dict[str, list[float]]:
    """The finished runs' values of one row, a list of seeds per scene."""
    scenes: dict[str, list[float]] = {}
    for run in runs:
        if run.row == row and run.problem is None and (number := value(run)) is not None:
            scenes.setdefault(run.scene, []).append(number)
    return scenes


def _t_quantile(freedom: float) -> float:
    return float(student.ppf(0.5 + CONFIDENCE / 2, freedom))
