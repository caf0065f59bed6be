"""Who is best at what, and how sure that is: the best row of a metric, and its lead over the next one seed by seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ia_bench.report.collect import Run
from ia_bench.report.statistics import Estimate, Paired, paired
from ia_bench.report.table import Block
from ia_bench.scores.columns import Metric


@dataclass(frozen=True)
class Leader:
    """The best row of a metric, among those that do not see the truth and have every scene.

    Attributes:
        metric: In what.
        row: The best.
        value: Its mean and interval.
        second: The next one; None where it is alone.
        lead: Best minus second, by scene and seed, positive where the best is better.
        scenes: How many scenes both rows have.
    """

    metric: Metric
    row: str
    value: Estimate
    second: str | None
    lead: Paired
    scenes: int

    @property
    def sure(self) -> str:
        """Whether the lead's interval over seeds holds zero, in words; nothing is decided where a scene has no pair of runs."""
        found = self.lead.over_seeds
        if self.second is None:
            return "the only row"
        if found is None:
            return "no seed in common: how sure is unknown"
        if len(self.lead.pairs) < self.scenes:
            return "no seed in common on some scene: how sure is unknown"
        if found.half_width is None:
            return "one seed: how sure is unknown"
        if abs(found.mean) <= found.half_width:
            return "undecided: other seeds may turn it"
        return "decided over seeds" if found.mean > 0 else "behind on shared seeds"


def leaders(runs: Sequence[Run], block: Block, metrics: Sequence[Metric]) -> list[Leader]:
    """The leader of every metric that some row has in all of the block's scenes; ``runs`` are those of its scenes."""
    found = []
    for metric in metrics:
        ranked = [
            (value.mean, one.row, value)
            for one in block.lines
            if not one.sees_truth and (value := one.values[metric.key]) is not None and value.scenes == block.scenes
        ]
        if not ranked:
            continue
        ranked.sort(key=lambda entry: -entry[0] if metric.higher_is_better else entry[0])
        row, value = ranked[0][1:]
        second = ranked[1][1] if len(ranked) > 1 else None
        pair = (row, second or row) if metric.higher_is_better else (second or row, row)
        found.append(Leader(metric, row, value, second, paired(runs, *pair, metric), block.scenes))
    return found
