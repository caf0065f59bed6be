"""Orderings that somebody claims, one row above another, and what the runs say about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from ia_bench.report.collect import Run
from ia_bench.report.statistics import Estimate, over_scenes
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRIC_OF, Metric


class Outcome(Enum):
    """What the 95 % interval of a difference says: it lies above zero, below zero, or holds it."""

    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Verdict:
    """``advantage`` of the row ``better`` over ``worse``, positive where the claim holds; None where they share no run.

    ``complete``: whether they share runs in every scene.
    """

    better: str
    worse: str
    metric: Metric
    advantage: Estimate | None
    complete: bool

    @property
    def outcome(self) -> Outcome:
        """Undecided also where a scene is missing, and without an interval, which needs two seeds of both rows in every scene."""
        if self.advantage is None or self.advantage.half_width is None or not self.complete:
            return Outcome.UNDECIDED
        if self.advantage.mean - self.advantage.half_width > 0:
            return Outcome.REPRODUCED
        if self.advantage.mean + self.advantage.half_width < 0:
            return Outcome.NOT_REPRODUCED
        return Outcome.UNDECIDED


def judge(runs: Sequence[Run], claims: Sequence[Claim], scenes: Sequence[str]) -> list[Verdict]:
    """One verdict for every metric of every claim about ``scenes``, over the scenes and seeds that both rows have.

    A difference is taken seed by seed; the interval tells how far other seeds on the same scenes would move its mean.
    Raises ValueError for a metric that there is not.
    """
    verdicts = []
    for claim in claims:
        for key in claim.metrics:
            if key not in METRIC_OF:
                raise ValueError(f"claims: metrics: expected some of {', '.join(METRIC_OF)}, found {key}")
            metric = METRIC_OF[key]
            better, worse = (_values(runs, row, metric) for row in (claim.better, claim.worse))
            sign = 1 if metric.higher_is_better else -1
            differences: dict[str, list[float]] = {}
            for scene, seed in sorted(better.keys() & worse.keys()):
                differences.setdefault(scene, []).append(sign * (better[scene, seed] - worse[scene, seed]))
            advantage = over_scenes(list(differences.values()))
            verdicts.append(Verdict(claim.better, claim.worse, metric, advantage, differences.keys() >= set(scenes)))
    return verdicts


def _values(runs: Sequence[Run], row: str, metric: Metric) -> dict[tuple[str, int], float]:
    """The finished runs' values of one row by scene and seed."""
    mine = (run for run in runs if run.row == row and run.problem is None)
    return {(run.scene, run.seed): value for run in mine if (value := run.metrics[metric.key]) is not None}
