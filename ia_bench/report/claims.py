"""Orderings that somebody claims, one row above another, and what the runs say about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from ia_bench.report.collect import Runs
from ia_bench.report.statistics import Estimate, Paired, better, side_by_side
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRIC_OF, Metric

HOW_JUDGED = """\
A row is claimed to be above another one, and judged with our small prior on our own scenes, not with those of the paper. The
difference is positive where the row is above, seed by seed on the same scenes, ± the 95 % interval over seeds / over scenes.
Reproduced: the interval over seeds lies above zero; not reproduced: below it; undecided: around it, or there is none. Carried by:
the run without which the mean is zero or has the other sign; ‡ the same within a scene. Every line is judged alone, without a
correction for their number."""
"""What a reader has to know of the table of claims; the same words stand in report.md and on the page."""


class Outcome(Enum):
    """What the 95 % interval over seeds of a difference says: it lies above zero, below zero, or holds it."""

    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Verdict:
    """What the runs say about one metric of a claim.

    Attributes:
        better: The row that is claimed to be above.
        worse: The row that is claimed to be below.
        metric: In which metric.
        pairs: Better minus worse by scene and seed, positive where the claim holds.
        complete: Whether the two rows share runs in every scene.
    """

    better: str
    worse: str
    metric: Metric
    pairs: Paired
    complete: bool

    @property
    def advantage(self) -> Estimate | None:
        """The mean of the pairs with its interval over seeds; None where the rows share no run."""
        return self.pairs.over_seeds

    @property
    def outcome(self) -> Outcome:
        """Undecided also where a scene is missing, and without an interval, which needs two seeds of both rows in every scene."""
        if self.advantage is None or self.advantage.half_width is None or not self.complete:
            return Outcome.UNDECIDED
        if abs(self.advantage.mean) <= self.advantage.half_width:
            return Outcome.UNDECIDED
        return Outcome.REPRODUCED if self.advantage.mean > 0 else Outcome.NOT_REPRODUCED


def judge(runs: Runs, claims: Sequence[Claim], scenes: Sequence[str]) -> list[Verdict]:
    """One verdict for every metric of every claim about ``scenes``, over the scenes and seeds that both rows have.

    A difference is taken seed by seed; the interval tells how far other seeds on the same scenes would move its mean.
    """
    scores = {key: side_by_side(runs, METRIC_OF[key]) for key in {key for claim in claims for key in claim.metrics}}
    verdicts = []
    for claim in claims:
        for metric in map(METRIC_OF.__getitem__, claim.metrics):
            pairs = better(scores[metric.key], claim.better, claim.worse, metric)
            verdicts.append(Verdict(claim.better, claim.worse, metric, pairs, pairs.pairs.keys() >= set(scenes)))
    return verdicts


def tally(verdicts: Sequence[Verdict]) -> str:
    """How many verdicts there are of each kind, in a sentence."""
    counts = ", ".join(f"{sum(one.outcome is outcome for one in verdicts)} {outcome.value}" for outcome in Outcome)
    return f"With our small prior: {counts}."
