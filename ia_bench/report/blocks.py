"""The lines of a table: what every row has, over one scene or over all of them, and who leads in each metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ia_bench.report.collect import Runs, finished, reason_of
from ia_bench.report.statistics import Estimate, Judged, better, is_small, judged, means, side_by_side
from ia_bench.scores.metrics import MEASURED, METRICS, Metric

PSNRS = tuple(metric for metric in METRICS if metric.label == "PSNR")
"""Metrics that are taken over the object's pixels, and over whole images too."""


@dataclass(frozen=True)
class Leader(Judged):
    """The best ``row`` of a metric among those that do not see the truth and have every one of ``scenes`` scenes.

    ``value``: its mean; ``second``: the next row, None where it is alone; ``pairs``: best minus second.
    """

    row: str
    value: Estimate
    second: str | None
    scenes: int

    @property
    def sure(self) -> str:
        """How sure the lead is, in words."""
        if self.second is None:
            return "the only row"
        if self.p_value is None:
            return "too few runs in common: how sure is unknown"
        if not is_small(self.p_value):
            return f"undecided: other {'scenes' if self.scenes > 1 else 'seeds'} may turn it"
        if self.pairs.scenes.mean() < 0:
            return "behind on shared seeds"
        return "decided" if self.survives else "decided alone"


@dataclass(frozen=True)
class Line:
    """One row of a table, over one scene or over all."""

    row: str  # its name
    sees_truth: bool  # whether a run of it saw the ground truth
    values: dict[str, Estimate | None]  # metric key -> estimate, None where undefined
    whole: dict[str, Estimate | None]  # key of a PSNR -> the same over whole images, not the object's pixels
    reasons: dict[str, tuple[str, ...]]  # metric key -> why finished runs have no value, each reason once
    seconds: Estimate | None  # mean over scenes and seeds
    peak_memory_bytes: float | None  # the largest of its runs
    failed: int  # number of failed runs, of ``runs``
    runs: int  # number of runs
    declared: bool = False  # whether its results were made elsewhere, so that its seconds are what somebody says


@dataclass(frozen=True)
class Block:
    """The lines of all rows over one scene, or over all ``scenes`` of them, and the leader of every metric that has one."""

    title: str
    lines: tuple[Line, ...]
    leaders: dict[str, Leader]
    scenes: int = 1

    def is_best(self, row: str, metric: Metric) -> bool:
        """Whether a row stands in bold: it leads, and that is decided."""
        leader = self.leaders.get(metric.key)
        return leader is not None and leader.row == row and leader.sure == "decided"


def block(runs: Runs, rows: Sequence[str], scenes: Sequence[str], title: str) -> Block:
    """Summarise the runs of ``scenes``, a line for every row."""
    runs = runs[runs["scene"].isin(scenes)]
    estimates = {metric.key: means(runs, metric.column) for metric in MEASURED}
    whole = {metric.key: means(runs, f"{metric.component}_whole_image_psnr") for metric in PSNRS}
    seconds, groups, lines = means(runs, "seconds"), dict(iter(runs.groupby("row"))), []
    for row in rows:
        mine = groups.get(row, runs.iloc[:0])
        done = finished(mine)
        reasons = {m.key: done.loc[done[m.column].isna(), "reasons"] for m in MEASURED}
        memory = done["peak_memory_bytes"].max()
        lines.append(
            Line(
                row=row,
                sees_truth=bool(mine["sees_truth"].eq(True).any()),
                values={key: found.get(row) for key, found in estimates.items()},
                whole={key: found.get(row) for key, found in whole.items()},
                reasons={key: tuple(dict.fromkeys(reason_of(one, key) for one in found)) for key, found in reasons.items()},
                seconds=seconds.get(row),
                peak_memory_bytes=None if pd.isna(memory) else int(memory),
                failed=len(mine) - len(done),
                runs=len(mine),
                declared="declared" in mine and bool(mine["declared"].notna().any()),
            )
        )
    leaders = [found for metric in MEASURED if (found := _leader(runs, lines, metric, len(scenes))) is not None]
    return Block(title, tuple(lines), {one.metric.key: one for one in judged(leaders)}, len(scenes))


def _leader(runs: Runs, lines: Sequence[Line], metric: Metric, scenes: int) -> Leader | None:
    known = [(one.row, one.values[metric.key]) for one in lines if not one.sees_truth]
    ranked = [(row, value) for row, value in known if value is not None and value.scenes == scenes]
    if not ranked:
        return None
    ranked.sort(key=lambda entry: entry[1].mean, reverse=metric.higher_is_better)
    (row, value), second = ranked[0], ranked[1][0] if len(ranked) > 1 else None
    pairs = better(side_by_side(runs, metric.column), row, second or row, metric)
    return Leader(metric, pairs, second is not None and len(pairs.pairs) == scenes, row, value, second, scenes)
