"""Error against run time of one run, as its curve.csv has it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ia_bench.scores.columns import CURVE_METRICS


class BadCurve(ValueError):
    """A curve.csv is not what the format says."""


@dataclass(frozen=True)
class Curve:
    """Error against run time.

    Attributes:
        steps: Steps of optimisation, (N,).
        seconds: Seconds of optimisation without scoring, (N,).
        values: Column of curve.csv -> (N,) float64, NaN where not measured.
    """

    steps: np.ndarray
    seconds: np.ndarray
    values: dict[str, np.ndarray]

    @property
    def is_level(self) -> bool:
        """Whether nothing was optimised, as of the bounds: a level, not a curve."""
        return not (self.steps.any() and self.seconds.any())

    def measured(self, column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steps, seconds and values of one column where it has a finite value."""
        values = self.values.get(column, np.full(len(self.steps), np.nan))
        there = np.isfinite(values)
        return self.steps[there], self.seconds[there], values[there]


def read_curve(path: Path) -> Curve | None:
    """Read a curve.csv; None where there is none. Raises :class:`BadCurve` naming file and line."""
    if not path.is_file():
        return None
    try:
        texts = pd.read_csv(path, dtype=str)
    except (OSError, ValueError) as error:  # of pandas, its own errors are among them
        raise BadCurve(f"{path}: expected a CSV file, found: {error}") from error
    missing = next((name for name in ("step", "seconds") if name not in texts), None)
    if missing is not None:
        raise BadCurve(f"{path}: expected a column {missing}, found {', '.join(texts.columns)}")
    columns = [metric.column for metric in CURVE_METRICS]
    numbers = texts.reindex(columns=["step", "seconds", *columns]).apply(pd.to_numeric, errors="coerce")
    for name in numbers:
        wrong = texts.index[numbers[name].isna() & texts[name].notna()] if name in texts else []
        if len(wrong):  # line 1 is the header
            raise BadCurve(f"{path}, line {wrong[0] + 2}, {name}: expected a number, found {texts[name][wrong[0]]!r}")
    steps, seconds = numbers["step"].to_numpy(float), numbers["seconds"].to_numpy(float)
    if not (np.isfinite(steps).all() and np.isfinite(seconds).all() and (np.diff(seconds) >= 0).all()):
        raise BadCurve(f"{path}: expected a step and rising seconds in every line")
    values = {name: numbers[name].to_numpy(float) for name in columns}
    return Curve(steps.astype(int), seconds, values) if len(texts) else None
