"""Error, variance and time as work-precision figures want them: pure functions, and timing in turns."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.common.atomic_file import whole_file


def relative_rmse(estimate: np.ndarray, reference: np.ndarray) -> float:
    """Root of the mean squared error over the mean of the reference: sqrt(<(e - r)^2>) / <r>; any shape.

    Not a mean of per-pixel ratios, which the darkest pixels would decide.
    """
    error = np.square(estimate.astype(np.float64) - reference.astype(np.float64)).mean()
    return float(np.sqrt(error) / reference.astype(np.float64).mean())


def converged(parts: np.ndarray) -> tuple[np.ndarray, float]:
    """The mean of (R, ...) independent estimates, R >= 2, and its own relative RMSE (its standard error over its mean)."""
    parts = parts.astype(np.float64)
    mean = parts.mean(0)
    standard_error = np.sqrt(parts.var(0, ddof=1).mean() / len(parts))
    return mean, float(standard_error / mean.mean())


class Moments:
    """Mean and variance of a vector (a gradient, any shape) over independent estimates that are not kept."""

    def __init__(self) -> None:
        self.count = 0
        self._sum: np.ndarray | None = None
        self._square = 0.0

    def add(self, estimate: np.ndarray) -> None:
        """Count one more estimate; all have the same shape."""
        vector = estimate.astype(np.float64)
        self.count += 1
        self._sum = vector if self._sum is None else self._sum + vector
        self._square += float(np.square(vector).sum())

    @property
    def mean(self) -> np.ndarray:
        """The converged estimate, in float64."""
        assert self._sum is not None
        return self._sum / self.count

    @property
    def variance(self) -> float:
        """E|g - E g|^2 of one estimate, summed over its components, without bias; needs two estimates."""
        return (self._square - self.count * float(np.square(self.mean).sum())) / (self.count - 1)

    @property
    def power(self) -> float:
        """|E g|^2 without bias: the square of the mean less the variance that is left in it."""
        return float(np.square(self.mean).sum()) - self.variance / self.count

    @property
    def relative_variance(self) -> float:
        """E|g - E g|^2 / |E g|^2 of one estimate; NaN where noise hides the mean (``power`` is not positive)."""
        return self.variance / self.power if self.power > 0 else math.nan

    def relative_distance(self, other: Moments) -> float:
        """|E g - E h|^2 / |E h|^2 without bias, so it may fall below 0 where the two agree within their noise."""
        distance = float(np.square(self.mean - other.mean).sum())
        return (distance - self.variance / self.count - other.variance / other.count) / other.power


def efficiency(variance: float, seconds: float) -> float:
    """1 / (variance x seconds): how much precision a second buys, whatever the number of samples."""
    return 1 / (variance * seconds)


def log_slope(work: Sequence[float], error: Sequence[float]) -> float:
    """Least-squares slope of log(error) over log(work): -0.5 for independent samples. NaN for fewer than two points."""
    pairs = [(w, e) for w, e in zip(work, error, strict=True) if w > 0 and e > 0 and math.isfinite(e)]
    if len(pairs) < 2:
        return math.nan
    x, y = np.log(np.array(pairs)).T
    return float(np.polyfit(x, y, 1)[0])


def without_compilation(steps: Sequence[int], seconds: Sequence[float]) -> list[float]:
    """Seconds of a fit's curve as if its first steps had run at the pace of the later ones.

    ``steps`` and ``seconds`` (N,) of the scored points, N >= 2; the first point's time holds the compiler's and is replaced
    by its steps times the seconds a step between the first point and the last.
    """
    pace = (seconds[-1] - seconds[0]) / (steps[-1] - steps[0])
    return [steps[0] * pace + later - seconds[0] for later in seconds]


def first_time(seconds: Sequence[float], values: Sequence[float], level: float) -> float | None:
    """The first measured time at which a PSNR is at or above ``level``, so an upper bound; None where it never is."""
    return next((s for s, value in zip(seconds, values, strict=True) if value >= level), None)


def time_in_turns(
    cases: Mapping[str, Callable[[int], Any]],
    rounds: int,
    warm_up: int,
    after: Callable[[str, Any], None] | None = None,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Wall and CPU seconds, each (rounds,), of every case, taken in turns so that a busy machine slows all of them alike.

    A case is called with the number of its run; the first ``warm_up`` runs, which compile, are discarded. ``after`` gets
    the name of the case and what it returned, off the clock.
    """
    for case in cases.values():
        for number in range(warm_up):
            case(number)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    for number in range(warm_up, warm_up + rounds):
        for name, case in cases.items():
            wall, cpu = time.perf_counter(), time.process_time()
            result = case(number)
            times[name].append((time.perf_counter() - wall, time.process_time() - cpu))
            if after is not None:
                after(name, result)
    return {name: (np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])) for name, pairs in times.items()}


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a CSV with the columns of the first row; None becomes an empty cell. Raises ValueError where columns differ."""
    columns = list(rows[0])
    if any(list(row) != columns for row in rows):
        raise ValueError(f"{path}: every row needs the columns {', '.join(columns)}")
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows([{key: _cell(value) for key, value in row.items()} for row in rows])


def _cell(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value
