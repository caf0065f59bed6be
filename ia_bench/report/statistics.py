"""Means and 95 % intervals over seeds and scenes, differences of rows, and what they decide. Failed runs enter no mean.

Seeds are repetitions: a scene's value is the mean over its seeds, with Student's t interval. Scenes are a sample of their kind: the
overall value is the plain mean of the scenes' means, and has two intervals. The one over seeds tells how far *other seeds on the
same scenes* would move it (Welch-Satterthwaite), the one over scenes how far *other scenes* would (Student). To compare two rows,
their scenes and seeds are paired (:class:`Paired`). What many comparisons decide together is corrected by Holm (:func:`holm`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from scipy.stats import binomtest
from scipy.stats import t as student

from ia_bench.report.collect import CELL, Runs, finished
from ia_bench.runs.table import Claim
from ia_bench.scores.metrics import METRIC_OF, Metric

CONFIDENCE = 0.95
ENOUGH_SIGNS = 8
"""From so many scenes on a sign test is printed: of fewer, it decides nothing or nearly so."""
INTERVALS = """\
± are 95 % intervals, “over seeds / over scenes”: how far other seeds on the same scenes would move the mean, and how far other
scenes of this kind would. A difference has a third, “/ new scene”: where that of one more scene would lie. – where nothing was
repeated."""
"""The one convention of all tables; the same words stand in report.md, in table.tex and on the page."""
HOW_DECIDED = """\
Each p-value is that of the paired t-test over scenes (over seeds, where there is one scene). Decided is what survives Holm's
correction at 5 % among {family}; “alone” is what would be decided only if it stood alone; all else is undecided."""
HOW_JUDGED = f"""\
A row is claimed to be above another one; the difference is positive where it is, seed by seed on the same scenes. {
    HOW_DECIDED.format(family="all metrics of all claims here")
} Decided are “reproduced”, where the row is above, and “not reproduced”, where it is below. Carried by: the run without which the
mean is zero or has the other sign; ‡ the same within a scene."""
"""What a reader has to know of the table of claims; the same words stand in report.md and on the page."""

OUTCOMES = ("reproduced", "not reproduced", "reproduced alone", "not reproduced alone", "undecided")
ScoresByCell = dict[str, dict[tuple[str, int], float]]
"""Row -> (scene, seed) -> score."""


@dataclass(frozen=True)
class Estimate:
    """``mean`` over ``scenes`` scenes, plus or minus ``half_width`` over seeds and ``wider`` over scenes (95 %).

    A width is None where nothing was repeated.
    """

    mean: float
    half_width: float | None
    scenes: int = 1
    wider: float | None = None


@dataclass(frozen=True)
class Paired:
    """Differences of two rows in one metric: scene -> seed -> difference, of the seeds that both rows have."""

    pairs: dict[str, dict[int, float]]

    @classmethod
    def of(cls, cells: Mapping[tuple[str, int], float]) -> Paired:
        """From (scene, seed) -> difference."""
        pairs: dict[str, dict[int, float]] = {}
        for (scene, seed), value in cells.items():
            pairs.setdefault(scene, {})[seed] = value
        return cls(pairs)

    @property
    def seeds(self) -> list[np.ndarray]:
        """The differences of every scene."""
        return [np.array(list(seeds.values())) for seeds in self.pairs.values()]

    @property
    def scenes(self) -> np.ndarray:
        """The mean difference of every scene."""
        return np.array([seeds.mean() for seeds in self.seeds])

    @property
    def over_seeds(self) -> Estimate | None:
        """The mean, with the intervals within which other seeds on the same scenes, and other scenes, would move it."""
        return over_scenes(self.seeds)

    @property
    def new_scene(self) -> float | None:
        """Half the width of Student's 95 % prediction interval around the mean, in which the difference on one more scene lies.

        t(.975) s sqrt(1 + 1/n) for n scenes whose means have the standard deviation s; None for a single scene.
        """
        width = half_width(self.scenes)
        return None if width is None else width * math.sqrt(len(self.pairs) + 1)

    @property
    def p_value(self) -> float | None:
        """The p-value of the two-sided paired t-test over scenes that the mean is zero, or over seeds where there is one scene.

        None where nothing was repeated.
        """
        values = self.scenes if len(self.pairs) > 1 else np.concatenate([*self.seeds, []])
        if len(values) < 2:
            return None
        error = float(values.std(ddof=1)) / math.sqrt(len(values))
        if error == 0:
            return 1.0 if values.mean() == 0 else 0.0
        return float(2 * student.sf(abs(values.mean()) / error, len(values) - 1))

    @property
    def signs(self) -> tuple[int, int, float] | None:
        """Scenes above zero, scenes that are not zero, and the two-sided sign test's p-value; None below ENOUGH_SIGNS scenes."""
        above, below = int((self.scenes > 0).sum()), int((self.scenes < 0).sum())
        if len(self.pairs) < ENOUGH_SIGNS or not above + below:
            return None
        return above, above + below, float(binomtest(above, above + below).pvalue)

    @property
    def carriers(self) -> list[tuple[str, int]]:
        """The pairs (scene, seed) that carry the mean: without any one of them it is zero or has the other sign."""
        means = dict(zip(self.pairs, self.scenes.tolist(), strict=True))
        mean = float(self.scenes.mean()) if means else 0.0
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
class Judged:
    """Two rows in one ``metric``, judged together with others.

    ``pairs``: their differences, positive where the first one is better; ``complete``: whether they share runs in every scene;
    ``survives``: whether the difference is decided among all that are judged together.
    """

    metric: Metric
    pairs: Paired
    complete: bool
    survives: bool = field(default=False, kw_only=True)

    @property
    def p_value(self) -> float | None:
        """None also where a scene is missing: what survives of a row that failed elsewhere decides nothing."""
        return self.pairs.p_value if self.complete else None

    @property
    def alone(self) -> bool:
        """Whether it would be decided only if it stood alone."""
        return is_small(self.p_value) and not self.survives


J = TypeVar("J", bound=Judged)


def judged(family: Sequence[J]) -> list[J]:
    """The same, each with whether it survives Holm's correction among all of the family."""
    survivors = holm([one.p_value for one in family])
    return [replace(one, survives=survives) for one, survives in zip(family, survivors, strict=True)]


@dataclass(frozen=True)
class Verdict(Judged):
    """What the runs say about one metric of a claim that row ``better`` is above row ``worse``, among all claims of its table."""

    better: str
    worse: str

    @property
    def outcome(self) -> str:
        """One of OUTCOMES: decided where it ``survives``; undecided also where there is no p-value."""
        if not is_small(self.p_value):
            return "undecided"
        return f"{'' if self.pairs.scenes.mean() > 0 else 'not '}reproduced{' alone' if self.alone else ''}"


def half_width(values: np.ndarray) -> float | None:
    """Half the width of Student's interval around the mean of independent values; None below two."""
    if len(values) < 2:
        return None
    return float(student.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * values.std(ddof=1)) / math.sqrt(len(values))


def over_scenes(values: Sequence[Sequence[float] | np.ndarray]) -> Estimate | None:
    """Mean over scenes of the mean over each scene's seeds; scenes without a value are left out and not counted.

    The interval over seeds needs two of them in every scene: standard error sqrt(sum s_i^2 / n_i) / S over S scenes, with Welch and
    Satterthwaite's degrees of freedom.
    """
    scenes = [np.asarray(seeds, dtype=np.float64) for seeds in values if len(seeds)]
    if not scenes:
        return None
    each = np.array([seeds.mean() for seeds in scenes])
    found = Estimate(float(each.mean()), None, len(scenes), half_width(each))
    if min(map(len, scenes)) < 2:
        return found
    variances = np.array([seeds.var(ddof=1) / len(seeds) for seeds in scenes])
    total = variances.sum()
    if total == 0:
        return replace(found, half_width=0.0)
    freedom = total**2 / sum(v**2 / (len(seeds) - 1) for v, seeds in zip(variances, scenes, strict=True))
    return replace(found, half_width=float(student.ppf(0.5 + CONFIDENCE / 2, freedom)) * math.sqrt(total) / len(scenes))


def is_small(p_value: float | None) -> bool:
    """Whether a p-value decides something that stands alone."""
    return p_value is not None and p_value <= 1 - CONFIDENCE


def holm(p_values: Sequence[float | None]) -> list[bool]:
    """Which hypotheses of a family are rejected, so that with probability .95 none is rejected wrongly (Holm 1979).

    Of m p-values the k-th smallest is rejected if it is at most .05 / (m - k + 1), as are all before it. None was not tested, and
    does not count.
    """
    known = sorted((value, place) for place, value in enumerate(p_values) if value is not None)
    found = [False] * len(p_values)
    for rank, (value, place) in enumerate(known):
        if value > (1 - CONFIDENCE) / (len(known) - rank):
            break
        found[place] = True
    return found


def means(runs: Runs, column: str) -> dict[str, Estimate | None]:
    """Row -> the mean of a column over the scenes of its finished runs, of rows that have a value."""
    scenes: dict[str, list[np.ndarray]] = {}
    if column in runs:
        for (row, _), values in finished(runs).dropna(subset=[column]).groupby(["row", "scene"])[column]:
            scenes.setdefault(row, []).append(values.to_numpy(float))
    return {row: over_scenes(values) for row, values in scenes.items()}


def side_by_side(runs: Runs, column: str) -> ScoresByCell:
    """Row -> (scene, seed) -> value of its finished runs in one column, where it is known."""
    known = finished(runs).dropna(subset=[column]).sort_values(["scene", "seed"])
    found: ScoresByCell = {}
    for row, scene, seed, value in zip(*(known[name].tolist() for name in (*CELL, column)), strict=True):
        found.setdefault(row, {})[scene, seed] = value
    return found


def paired(scores: ScoresByCell, row: str, reference: str) -> Paired:
    """Row minus reference wherever both have a value for the same scene and seed."""
    theirs = scores.get(reference, {})
    return Paired.of({cell: value - theirs[cell] for cell, value in scores.get(row, {}).items() if cell in theirs})


def better(scores: ScoresByCell, row: str, other: str, metric: Metric) -> Paired:
    """Differences of ``row`` and ``other`` at the same scenes and seeds, positive where ``row`` is the better one."""
    return paired(scores, row, other) if metric.higher_is_better else paired(scores, other, row)


def judge(runs: Runs, claims: Sequence[Claim], scenes: Sequence[str]) -> list[Verdict]:
    """One verdict for every metric of every claim about ``scenes``, over the scenes and seeds that both rows have.

    All of them are one family: whether one ``survives`` depends on how many there are.
    """
    verdicts = []
    for claim in claims:
        for metric in map(METRIC_OF.__getitem__, claim.metrics):
            pairs = better(side_by_side(runs, metric.column), claim.better, claim.worse, metric)
            verdicts.append(Verdict(metric, pairs, pairs.pairs.keys() >= set(scenes), claim.better, claim.worse))
    return judged(verdicts)
