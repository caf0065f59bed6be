"""Error against run time: when a given error is reached, and where more time makes it worse.

Only measured points are used, never values between them: a time to reach an error is that of the first measured point
at or beyond it, so an upper bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ia_bench.report.collect import Runs
from ia_bench.report.statistics import Estimate, over_seeds
from ia_bench.scores.columns import CURVE_METRICS, Metric

LEVELS: dict[str, tuple[float, ...]] = {  # what "given errors" are: dB for PSNR, squared perceptual roughness for MSE
    "albedo_psnr": (15.0, 20.0, 25.0, 30.0),
    "aligned_albedo_psnr": (15.0, 20.0, 25.0, 30.0),
    "view_synthesis_psnr": (20.0, 25.0, 30.0),
    "relighting_psnr": (20.0, 25.0, 30.0),
    "roughness_mse": (0.1, 0.05, 0.02, 0.01),
}
BEATEN = ("aligned_albedo.psnr", "relighting.psnr")  # metrics in which rows are timed against the reference
WORSE_DB = 0.1  # a loss below this is taken for the noise of the scoring renders and not reported

Points = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Steps, seconds and values of one run's curve."""


@dataclass(frozen=True)
class TimeToError:
    """Seconds of optimisation until a metric first reaches ``level``, over the ``reached`` of ``seeds`` that do."""

    row: str
    scene: str
    metric: Metric
    level: float
    seconds: Estimate | None
    reached: int
    seeds: int

    @property
    def text(self) -> str:
        """Seconds, "never", or both where only some seeds reach the level."""
        if self.seconds is None:
            return "never"
        some = f" ({self.reached} of {self.seeds} seeds)" if self.reached < self.seeds else ""
        return f"{seconds_text(self.seconds.mean)}{some}"


@dataclass(frozen=True)
class Worsening:
    """A metric that ends worse than it was: its best value, when that was, and its final value, as means over ``seeds``.

    ``loss_db`` is best minus final PSNR, or 10 log10(final / best) of a squared error.
    """

    row: str
    scene: str
    metric: Metric
    best: float
    best_step: float
    best_seconds: float
    final: float
    final_seconds: float
    loss_db: float
    seeds: int


def seconds_text(seconds: float) -> str:
    """Seconds with a digit behind the point below 100."""
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds:.0f} s"


def time_to_error(runs: Runs) -> list[TimeToError]:
    """For every row and scene with curves and every one of LEVELS; a metric that a curve never measured is left out."""
    table = []
    for metric in CURVE_METRICS:
        for (row, scene), curves in _measured(runs, metric).items():
            table += [_reach(row, scene, metric, level, curves) for level in LEVELS.get(metric.column, ())]
    return table


def time_to_beat(runs: Runs, reference: str) -> list[TimeToError]:
    """For every scene and metric of BEATEN and every row but ``reference``: until it is where the reference is at its best.

    The level is the best value that the reference's curve ever has on the scene, the mean over its seeds; seconds hold those
    of the prior.
    """
    table = []
    for metric in (one for one in CURVE_METRICS if one.key in BEATEN):
        best = max if metric.higher_is_better else min
        curves = _measured(runs, metric)
        levels = {
            scene: float(np.mean([best(values) for _, _, values in theirs]))
            for (row, scene), theirs in curves.items()
            if row == reference
        }
        for (row, scene), ours in curves.items():
            if row != reference and scene in levels:
                table.append(_reach(row, scene, metric, levels[scene], ours))
    return table


def worsening(runs: Runs) -> list[Worsening]:
    """Every row, scene and metric that ends WORSE_DB or more below its best (mean of seeds), largest first."""
    found = []
    for metric in CURVE_METRICS:
        for (row, scene), curves in _measured(runs, metric).items():
            losses = [_loss(*curve, metric) for curve in curves]
            best_step, best_seconds, best, final_seconds, final, loss = np.mean(losses, axis=0).tolist()
            if loss >= WORSE_DB:
                found.append(Worsening(row, scene, metric, best, best_step, best_seconds, final, final_seconds, loss, len(curves)))
    return sorted(found, key=lambda one: -one.loss_db)


def _reach(row: str, scene: str, metric: Metric, level: float, curves: Sequence[Points]) -> TimeToError:
    times = [_first_time(seconds, values, level, metric) for _, seconds, values in curves]
    reached = [time for time in times if time is not None]
    return TimeToError(row, scene, metric, level, over_seeds(reached), len(reached), len(times))


def _measured(runs: Runs, metric: Metric) -> dict[tuple[str, str], list[Points]]:
    """Steps, seconds and values per row and scene, one entry per seed, of optimisations that measured the metric."""
    curves: dict[tuple[str, str], list[Points]] = {}
    for row, scene, curve in zip(runs["row"], runs["scene"], runs["curve"], strict=True):
        if curve is not None and not curve.is_level and len((points := curve.measured(metric.column))[0]):
            curves.setdefault((row, scene), []).append(points)
    return curves


def _first_time(seconds: np.ndarray, values: np.ndarray, level: float, metric: Metric) -> float | None:
    there = np.flatnonzero(values >= level if metric.higher_is_better else values <= level)
    return float(seconds[there[0]]) if len(there) else None


def _loss(steps: np.ndarray, seconds: np.ndarray, values: np.ndarray, metric: Metric) -> tuple[float, ...]:
    """Step, seconds and value of the best point, seconds and value of the last, and the loss between them in dB."""
    index = int(np.argmax(values) if metric.higher_is_better else np.argmin(values))
    best, final = float(values[index]), float(values[-1])
    if metric.higher_is_better:
        loss = best - final
    else:
        loss = 10 * math.log10(final / best) if best > 0 else (0.0 if final == 0 else math.inf)
    return float(steps[index]), float(seconds[index]), best, float(seconds[-1]), final, loss
