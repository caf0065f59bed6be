"""How many photographs a prior is worth: how many the reference needs to be where the row is with fewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ia_bench.report.bootstrap import Interval, interval, replicates
from ia_bench.report.collect import Runs
from ia_bench.report.gains import compared, with_photographs
from ia_bench.report.statistics import Scores, side_by_side
from ia_bench.runs.table import Table, capture_of, crossed_name
from ia_bench.scores.columns import METRIC_OF, Metric

WORTH_METRICS = (METRIC_OF["aligned_albedo.psnr"], METRIC_OF["relighting.psnr"])


@dataclass(frozen=True)
class Worth:
    """What a row with ``photographs`` of them is worth in photographs of the reference.

    Attributes:
        row: The row, without its capture.
        others: The label of the capture without its number of views: "" or "LDR", say.
        metric: In which the two are equal.
        photographs: How many the row has.
        needed: How many the reference needs for the same value, by linear interpolation in the logarithm of their number; infinite
            where the reference does not get there with all, 0 where its fewest are better.
        bounds: Of ``needed``, by the bootstrap over scenes and seeds; None for a single scene.
        scenes: Over how many scenes the mean is.
        pairs: How many runs of the row it rests on, each beside those of the reference of the same scene and seed.
    """

    row: str
    others: str
    metric: Metric
    photographs: int
    needed: float
    bounds: Interval | None
    scenes: int
    pairs: int


def worth(runs: Runs, table: Table) -> list[Worth]:
    """For every row of ``table`` but its reference and every number of photographs; captures that differ in more stand apart.

    Captures that differ in nothing but that number are a family. Those scenes and seeds count that have the reference with all
    numbers of the family, and the row with the one in question.
    """
    table = with_photographs(table, runs)
    families: dict[str, dict[int, str]] = {}
    for capture in map(capture_of, table.captures):
        count = table.photographs if capture.views == "all" else int(capture.views)
        families.setdefault(capture.others, {})[count] = capture.label
    scores = {metric: side_by_side(runs, metric) for metric in WORTH_METRICS}
    found = []
    for others, labels in families.items():
        curve = sorted(labels)
        for row in compared(table) if len(curve) > 1 else []:
            asked = [count for count in curve if row.captures is None or labels[count] in row.captures]
            references = [crossed_name(str(table.reference), labels[count]) for count in curve]
            for metric, count in product(WORTH_METRICS, asked):
                scenes = _together(scores[metric], [*references, crossed_name(row.name, labels[count])])
                if scenes:
                    found.append(_worth(row.name, others, metric, count, curve, scenes))
    return found


def _together(scores: Scores, rows: Sequence[str]) -> list[np.ndarray]:
    """One array (seeds, rows) for every scene, of the seeds that all rows have."""
    found: dict[str, list[list[float]]] = {}
    for scene, seed in scores.get(rows[0], {}):
        values = [scores[row][scene, seed] for row in rows if (scene, seed) in scores.get(row, {})]
        if len(values) == len(rows):
            found.setdefault(scene, []).append(values)
    return [np.array(seeds) for seeds in found.values()]


def _worth(row: str, others: str, metric: Metric, photographs: int, curve: Sequence[int], scenes: Sequence[np.ndarray]) -> Worth:
    """``scenes``: arrays (seeds, the reference with each number of ``curve`` and then the row with ``photographs``)."""
    means = np.mean([seeds.mean(axis=0) for seeds in scenes], axis=0)[None]
    bounds = interval(_needed(replicates(scenes), curve)) if len(scenes) > 1 else None
    pairs = sum(map(len, scenes))
    return Worth(row, others, metric, photographs, float(_needed(means, curve)[0]), bounds, len(scenes), pairs)


def _needed(values: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """Photographs that the reference needs in each experiment of ``values`` (experiments, ``counts`` and one).

    The last column is the row's, those before it are the reference's. More photographs count as never worse: its curve is the
    running best.
    """
    curves = np.maximum.accumulate(values[:, :-1], axis=1)
    found = np.empty(len(values))
    for i, (curve, level) in enumerate(zip(curves, values[:, -1], strict=True)):
        if level > curve[-1]:
            found[i] = np.inf
        elif level < curve[0]:
            found[i] = 0
        else:
            above = int(np.searchsorted(curve, level))  # the first that is no worse
            below = max(above - 1, 0)
            rise = curve[above] - curve[below]
            part = (level - curve[below]) / rise if rise > 0 else 0.0
            found[i] = np.exp2(np.log2(counts[below]) + part * (np.log2(counts[above]) - np.log2(counts[below])))
    return found
