"""Means and 95 % intervals over seeds and scenes, differences of rows, and what they decide. Failed runs enter no mean.

Seeds are repetitions: a scene's value is the mean over its seeds, with Student's t interval. Scenes are not: the
overall value is the plain mean of the scenes' means, and its interval tells how much *other seeds on the same scenes*
would move it (Welch-Satterthwaite). To compare two rows, their scenes and seeds are paired (:class:`Paired`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from scipy.stats import t as student

from ia_bench.report.collect import CELL, Runs, finished, reason_of
from ia_bench.runs.table import Claim
from ia_bench.scores.metrics import METRIC_OF, METRICS, Metric

CONFIDENCE = 0.95
HOW_JUDGED = """\
A row is claimed to be above another one, and judged with our small prior on our own scenes, not with those of the paper. The
difference is positive where the row is above, seed by seed on the same scenes, ± the 95 % interval over seeds / over scenes.
Reproduced: the interval over seeds lies above zero; not reproduced: below it; undecided: around it, or there is none. Carried by:
the run without which the mean is zero or has the other sign; ‡ the same within a scene. Every line is judged alone, without a
correction for their number."""
"""What a reader has to know of the table of claims; the same words stand in report.md and on the page."""

Outcome = Literal["reproduced", "not reproduced", "undecided"]
Scores = dict[str, dict[tuple[str, int], float]]
"""Row -> (scene, seed) -> score."""


@dataclass(frozen=True)
class Estimate:
    """``mean`` over ``scenes`` scenes, plus or minus ``half_width`` (95 %), None where nothing was repeated."""

    mean: float
    half_width: float | None
    scenes: int = 1


@dataclass(frozen=True)
class Paired:
    """Differences of two rows in one metric: scene -> seed -> difference, of the seeds that both rows have."""

    pairs: dict[str, dict[int, float]]

    @property
    def seeds(self) -> list[np.ndarray]:
        """The differences of every scene."""
        return [np.array(list(seeds.values())) for seeds in self.pairs.values()]

    @property
    def over_seeds(self) -> Estimate | None:
        """The mean, with the interval within which other seeds on the same scenes would move it."""
        return over_scenes(self.seeds)

    @property
    def over_scenes(self) -> Estimate | None:
        """The same mean, with Student's interval over scenes: whether the difference would hold on others of this kind."""
        estimate = over_seeds([float(seeds.mean()) for seeds in self.seeds])
        return estimate and Estimate(estimate.mean, estimate.half_width, len(self.pairs))

    @property
    def carriers(self) -> list[tuple[str, int]]:
        """The pairs (scene, seed) that carry the mean: without any one of them it is zero or has the other sign."""
        means = {scene: float(np.mean(list(seeds.values()))) for scene, seeds in self.pairs.items()}
        mean = float(np.mean(list(means.values()))) if means else 0.0
        found = []
        for scene, seeds in self.pairs.items():
            for seed in seeds:
                rest = [value for other, value in seeds.items() if other != seed]
                left = [other for name, other in means.items() if name != scene] + ([float(np.mean(rest))] if rest else [])
                if mean and left and float(np.mean(left)) * mean <= 0:
                    found.append((scene, seed))
        return found

    @property
    def count(self) -> int:
        """How many pairs there are."""
        return sum(map(len, self.pairs.values()))

    def of_scene(self, scene: str) -> Paired:
        """The pairs of one scene alone."""
        return Paired({scene: self.pairs[scene]} if scene in self.pairs else {})


@dataclass(frozen=True)
class Verdict:
    """What the runs say about one metric of a claim that row ``better`` is above row ``worse``.

    ``pairs``: better minus worse, positive where the claim holds; ``complete``: whether the rows share runs in every scene.
    """

    better: str
    worse: str
    metric: Metric
    pairs: Paired
    complete: bool

    @property
    def outcome(self) -> Outcome:
        """Undecided also where a scene is missing, and without an interval, which needs two seeds of both rows in every scene."""
        found = self.pairs.over_seeds
        if found is None or found.half_width is None or not self.complete or abs(found.mean) <= found.half_width:
            return "undecided"
        return "reproduced" if found.mean > 0 else "not reproduced"


@dataclass(frozen=True)
class Leader:
    """The best ``row`` of a metric among those that do not see the truth and have every one of ``scenes`` scenes.

    ``value``: its mean; ``second``: the next row, None where it is alone; ``lead``: best minus second, positive is better.
    """

    row: str
    value: Estimate
    second: str | None
    lead: Paired
    scenes: int

    @property
    def sure(self) -> str:
        """How sure the lead is, in words: decided where its interval over seeds lies above zero, with pairs in every scene."""
        found = self.lead.over_seeds
        if self.second is None:
            return "the only row"
        if found is None or found.half_width is None or len(self.lead.pairs) < self.scenes:
            return "too few seeds in common: how sure is unknown"
        if abs(found.mean) <= found.half_width:
            return "undecided: other seeds may turn it"
        return "decided over seeds" if found.mean > 0 else "behind on shared seeds"


@dataclass(frozen=True)
class Line:
    """One row of a table, over one scene or over all."""

    row: str  # its name
    sees_truth: bool  # whether a run of it saw the ground truth
    values: dict[str, Estimate | None]  # metric key -> estimate, None where undefined
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
        return leader is not None and leader.row == row and leader.sure == "decided over seeds"


def over_seeds(values: Sequence[float]) -> Estimate | None:
    """Mean and Student's t interval of repetitions; None for no value."""
    return over_scenes([values]) if values else None


def over_scenes(values: Sequence[Sequence[float] | np.ndarray]) -> Estimate | None:
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


def means(runs: Runs, column: str) -> dict[str, Estimate | None]:
    """Row -> the mean of a column over the scenes of its finished runs, of rows that have a value."""
    scenes: dict[str, list[np.ndarray]] = {}
    if column in runs:
        for (row, _), values in finished(runs).dropna(subset=[column]).groupby(["row", "scene"])[column]:
            scenes.setdefault(row, []).append(values.to_numpy(float))
    return {row: over_scenes(values) for row, values in scenes.items()}


def side_by_side(runs: Runs, metric: Metric) -> Scores:
    """Row -> (scene, seed) -> score of its finished runs in one metric, where it is defined."""
    known = finished(runs).dropna(subset=[metric.column]).sort_values(["scene", "seed"])
    found: Scores = {}
    for row, scene, seed, value in zip(*(known[name].tolist() for name in (*CELL, metric.column)), strict=True):
        found.setdefault(row, {})[scene, seed] = value
    return found


def paired(scores: Scores, row: str, reference: str) -> Paired:
    """Row minus reference wherever both have a value for the same scene and seed."""
    theirs = scores.get(reference, {})
    pairs: dict[str, dict[int, float]] = {}
    for (scene, seed), value in scores.get(row, {}).items():
        if (scene, seed) in theirs:
            pairs.setdefault(scene, {})[seed] = value - theirs[scene, seed]
    return Paired(pairs)


def better(scores: Scores, row: str, other: str, metric: Metric) -> Paired:
    """The same, turned so that it is positive where ``row`` is the better one."""
    return paired(scores, row, other) if metric.higher_is_better else paired(scores, other, row)


def judge(runs: Runs, claims: Sequence[Claim], scenes: Sequence[str]) -> list[Verdict]:
    """One verdict for every metric of every claim about ``scenes``, over the scenes and seeds that both rows have."""
    verdicts = []
    for claim in claims:
        for metric in map(METRIC_OF.__getitem__, claim.metrics):
            pairs = better(side_by_side(runs, metric), claim.better, claim.worse, metric)
            verdicts.append(Verdict(claim.better, claim.worse, metric, pairs, pairs.pairs.keys() >= set(scenes)))
    return verdicts


def tally(verdicts: Sequence[Verdict]) -> str:
    """How many verdicts there are of each kind, in a sentence."""
    found = [one.outcome for one in verdicts]
    counts = (f"{found.count(outcome)} {outcome}" for outcome in ("reproduced", "not reproduced", "undecided"))
    return f"With our small prior: {', '.join(counts)}."


def block(runs: Runs, rows: Sequence[str], scenes: Sequence[str], title: str) -> Block:
    """Summarise the runs of ``scenes``, a line for every row."""
    runs = runs[runs["scene"].isin(scenes)]
    estimates = {metric.key: means(runs, metric.column) for metric in METRICS}
    seconds, groups, lines = means(runs, "seconds"), dict(iter(runs.groupby("row"))), []
    for row in rows:
        mine = groups.get(row, runs.iloc[:0])
        done = finished(mine)
        reasons = {m.key: done.loc[done[m.column].isna(), "reasons"] for m in METRICS}
        memory = done["peak_memory_bytes"].max()
        lines.append(
            Line(
                row=row,
                sees_truth=bool(mine["sees_truth"].eq(True).any()),
                values={key: found.get(row) for key, found in estimates.items()},
                reasons={key: tuple(dict.fromkeys(reason_of(one, key) for one in found)) for key, found in reasons.items()},
                seconds=seconds.get(row),
                peak_memory_bytes=None if pd.isna(memory) else int(memory),
                failed=len(mine) - len(done),
                runs=len(mine),
                declared="declared" in mine and bool(mine["declared"].notna().any()),
            )
        )
    leaders = {metric.key: _leader(runs, lines, metric, len(scenes)) for metric in METRICS}
    return Block(title, tuple(lines), {key: found for key, found in leaders.items() if found is not None}, len(scenes))


def _leader(runs: Runs, lines: Sequence[Line], metric: Metric, scenes: int) -> Leader | None:
    known = [(one.row, one.values[metric.key]) for one in lines if not one.sees_truth]
    ranked = [(row, value) for row, value in known if value is not None and value.scenes == scenes]
    if not ranked:
        return None
    ranked.sort(key=lambda entry: -entry[1].mean if metric.higher_is_better else entry[1].mean)
    (row, value), second = ranked[0], ranked[1][0] if len(ranked) > 1 else None
    return Leader(row, value, second, better(side_by_side(runs, metric), row, second or row, metric), scenes)
