"""The bootstrap of two levels: scenes are drawn again, and of each scene that is drawn its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ia_bench.report.statistics import CONFIDENCE

REPLICATES = 10_000


class Interval(NamedTuple):
    """From ``low`` to ``high``; either may be infinite."""

    low: float
    high: float

    @property
    def side(self) -> int:
        """1 where all of it lies above zero, -1 where all of it lies below, else 0."""
        return int(self.low > 0) - int(self.high < 0)


def replicates(scenes: Sequence[np.ndarray], count: int = REPLICATES) -> np.ndarray:
    """Means of ``count`` resampled experiments, (count, ...).

    Every replicate draws as many scenes as there are, with replacement, and for each of them as many of its seeds, with
    replacement; its value is the mean over scenes of the means over seeds. One seed a scene leaves the scenes alone to vary.

    Args:
        scenes: One array (seeds, ...) of at least one seed for each scene; what follows the seeds stays together, so that values of
            one run are drawn together.
        count: How many.
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


def interval(drawn: np.ndarray) -> Interval:
    """The middle 95 % of replicates (count,), some of which may be infinite."""
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], method="inverted_cdf")
    return Interval(float(low), float(high))
