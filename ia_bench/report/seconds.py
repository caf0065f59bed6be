"""What a row gains over its reference after the same seconds, and which rows nobody beats in less time.

Whoever compares a prior with none compares two methods of which one takes longer. A table names the rows that are its reference
with more work (:attr:`ia_bench.runs.table.Table.curve`: more steps, more samples). What the reference has after t seconds is
the best of them so far, scene by scene and seed by seed, on a straight line in log t between two that are each better than all
before. It is chosen by the score that is compared, which favours the reference; before its cheapest it has what that has.

Seconds are those of baking, prior and all steps, without scoring and the scene's preparation. They count as multiples of the
reference's, its cost, for a row as a whole: mean over scenes of means over the seeds that both have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ia_bench.common.errors import listed
from ia_bench.report.collect import Record, Runs, finished
from ia_bench.report.statistics import Paired, ScoresByCell, better, holm, side_by_side
from ia_bench.report.table import BOUNDS, Entry, Printed, difference_text
from ia_bench.runs.table import Table, capture_of, crossed_name
from ia_bench.scores.metrics import METRIC_OF, Metric

WORTH_METRICS = tuple(METRIC_OF[key] for key in ("aligned_albedo.psnr", "relighting.psnr"))
"""Metrics in which gains are told."""
CPU, WALL = "CPU seconds of the runs", "wall-clock seconds of the runs"
STATED = "CPU costs that the table states, measured with threads=1 on a core of their own"
UNEQUAL = ("cpu", "threads", "commit")
"""In which runs must not differ if their seconds are to compare."""
MOST = 4  # values of these that are named
LONG_COMMIT = r"^([0-9a-f]{12})[0-9a-f]+"  # of which 12 digits are shown, and whether the code was changed
NOTHING_LEFT_OUT = "all views"
"""What a capture without a label is called."""
BEYOND = ">"
"""What follows a gain where the row takes longer than the whole curve: the reference might gain more with as many seconds."""


@dataclass(frozen=True)
class AtEqualSeconds:
    """A row in one metric: its ``gain`` over the reference, the ``equal`` one at equal seconds, both positive where it is better.

    ``beyond``: whether it takes longer than the whole curve; ``judged``: whether the gain at equal seconds may be called decided,
    which takes every scene of either row, and a curve that is as long as the row and that the row is not part of; ``score``:
    its mean, None for one that is not ranked; ``front``: whether it is better than every ranked row that costs no more.
    """

    gain: Paired
    equal: Paired
    beyond: bool
    judged: bool
    score: float | None
    front: bool = False


@dataclass(frozen=True)
class Clock:
    """How long rows take under one capture. Rows are called by their whole names, with their capture.

    Attributes:
        capture: The capture's label.
        reference: The row that all others are compared with.
        rows: All rows that were run.
        costs: Row -> its seconds over the reference's, of those whose seconds compare.
        curve: Those of them that are the reference with more work, the reference among them, the cheapest first.
        lacking: Names of others that the table has for the curve, without their capture: they were not run, or not timed.
        ranked: Those of them that may stand on a Pareto front, since they do not see the truth.
    """

    capture: str
    reference: str
    rows: tuple[str, ...]
    costs: Mapping[str, float]
    curve: tuple[str, ...]
    lacking: tuple[str, ...]
    ranked: frozenset[str]

    def short(self, row: str) -> str:
        """The name of a row without its capture."""
        return row.removesuffix(f", {self.capture}") if self.capture else row

    def compared(self, scores: ScoresByCell, metric: Metric) -> dict[str, AtEqualSeconds]:
        """Row -> what it is beside the reference.

        At equal seconds those scenes and seeds count that the row and every row of the curve have; none for a row whose seconds do
        not compare. The front is of rows of ``ranked`` that share every scene with the reference: their score is its level and what
        they gain.
        """
        sign, own, found = 1 if metric.higher_is_better else -1, Paired.of(scores.get(self.reference, {})), {}
        for row in self.rows:
            gain, equal, cost = better(scores, row, self.reference, metric), {}, self.costs.get(row)
            for cell, score in scores.get(row, {}).items():
                if cost is not None and all(cell in scores.get(one, {}) for one in self.curve):
                    points = [(self.costs[one], sign * scores[one][cell]) for one in self.curve]
                    equal[cell] = sign * score - best_after(points, cost)
            pairs = Paired.of(equal)
            every = own.pairs.keys() | {scene for scene, _ in scores.get(row, {})}  # of some the reference may have failed
            whole = cost is not None and row in self.ranked and gain.count > 0 and gain.pairs.keys() == every
            mean = float(own.scenes.mean()) + sign * float(gain.scenes.mean()) if whole else None
            beyond = cost is not None and cost > self.costs[self.curve[-1]]
            judged = not beyond and row not in self.curve and pairs.pairs.keys() >= every
            found[row] = AtEqualSeconds(gain, pairs, beyond, judged, mean)
        ranked = {row: sign * one.score for row, one in found.items() if one.score is not None}
        ordered = sorted(ranked, key=lambda row: (self.costs[row], -ranked[row]))
        front = [row for place, row in enumerate(ordered) if all(ranked[row] > ranked[one] for one in ordered[:place])]
        return found | {row: replace(found[row], front=True) for row in front}


@dataclass(frozen=True)
class Timing:
    """The clock of every capture.

    ``runs``: all runs of the report; ``counted``: what seconds are (CPU, STATED, WALL); ``unequal``: why they hardly compare.
    """

    runs: Runs
    counted: str
    unequal: str
    clocks: tuple[Clock, ...]

    def compared(self, metric: Metric) -> dict[str, AtEqualSeconds]:
        """Row -> what it is beside its reference, capture after capture."""
        scores = side_by_side(self.runs, metric.column)
        return {row: one for clock in self.clocks for row, one in clock.compared(scores, metric).items()}

    @cached_property
    def gains(self) -> dict[Metric, dict[str, AtEqualSeconds]]:
        """The same in each of WORTH_METRICS."""
        return {metric: self.compared(metric) for metric in WORTH_METRICS}

    @property
    def told(self) -> str:
        """How seconds were counted and what the reference's curve is, in sentences; what spoils the comparison comes first."""
        clock = max(self.clocks, key=lambda one: len(one.curve))
        reference = clock.short(clock.reference)
        curve = ", ".join(f"“{clock.short(row)}” ({clock.costs[row]:.2f})" for row in clock.curve)
        curve += f" (as they are with {clock.capture or NOTHING_LEFT_OUT})" if len(self.clocks) > 1 else ""
        without: dict[str, list[str]] = {}
        for one in self.clocks:
            without.setdefault(" and ".join(f"“{name}”" for name in one.lacking), []).append(one.capture or NOTHING_LEFT_OUT)
        how = f"straight in the logarithm of seconds between two of them; {BEYOND} the row takes longer than the dearest"
        words = [
            self.unequal,
            f"Seconds are {self.counted}: baking, prior and all steps, without scoring and the scene's preparation, as multiples "
            f"of those of “{reference}”.",
            f"At equal seconds: the row minus the best of {curve} after the row's seconds, per scene and seed, {how}."
            if len(clock.curve) > 1
            else f"“{reference}” was not run with more work: what it has after more seconds is not known ({BEYOND}).",
            *(
                f"Without {names}, which the table names for that and which was not run or not timed"
                f"{f' with {listed(captures)}' if len(self.clocks) > 1 else ''}, gains at equal seconds may be too large."
                for names, captures in without.items()
                if names
            ),
        ]
        return " ".join(word for word in words if word)


def best_after(points: Iterable[tuple[float, float]], cost: float) -> float:
    """The best of ``points`` (cost, score; more is better) after ``cost``.

    Those that some cheaper one is as good as are passed over; between two others the score is straight in the logarithm of the
    cost. Before the cheapest it is that one's score, after the dearest the best.
    """
    kept: list[tuple[float, float]] = []
    for point in sorted(points, key=lambda one: (one[0], -one[1])):
        if not kept or point[1] > kept[-1][1]:
            kept.append(point)
    costs, scores = zip(*kept, strict=True)
    return float(np.interp(math.log(cost), np.log(costs), scores))


def timing(runs: Runs, table: Table, reference: str | None) -> Timing | None:
    """The clocks of a report's runs; None where nothing is compared, or no run of a reference took time.

    ``reference``: the row that all others are compared with, where the table's captures do not have one each. Seconds are CPU
    seconds where every run has them, else what the table states, if it does so of a reference, else wall-clock seconds.
    """
    done = finished(runs)
    labels = ["", *(capture_of(one).label for one in table.captures)]
    done = done[~done["row"].isin([crossed_name(row, label) for row in BOUNDS for label in labels])]
    there = list(done["row"].unique())
    if "declared" in done:  # somebody's seconds, on a machine of theirs
        done = done[done["declared"].isna()]
    done = done[done["seconds"] > 0]
    stated = {row.name: row.cost for row in table.crossed_rows if isinstance(row.cost, float)}  # of its own capture
    blind = frozenset(done["row"]) - set(done.loc[done["sees_truth"].eq(True), "row"])
    if table.captures:
        names = [row.name for row in table.rows]
        known = [(label, crossed_name(table.reference, label), names) for label in labels[1:]] if table.reference else []
    else:
        known = [("", reference, there)] if reference else []
    counted = WALL
    if len(done) and (done["cpu_seconds"] > 0).all():
        counted = CPU
    elif any(first in stated for _, first, _ in known):  # else there would be nothing to divide by
        counted = STATED
    spent = side_by_side(done, "cpu_seconds" if counted == CPU else "seconds")
    clocks = []
    for label, first, names in known:
        rows = tuple(row for name in names if (row := crossed_name(name, label)) in there)
        costs = {row: cost for row in rows if (cost := _cost(spent, row, first, stated if counted == STATED else None)) is not None}
        if first in costs:
            wanted = dict.fromkeys([first, *(crossed_name(name, label) for name in table.curve)])
            curve = sorted((row for row in wanted if row in costs), key=costs.__getitem__)  # in one order, also of equal costs
            lacking = tuple(name for name in table.curve if crossed_name(name, label) not in curve)
            clocks.append(Clock(label, first, rows, costs, tuple(curve), lacking, blind))
    measured = done[done["row"].isin([row for clock in clocks for row in clock.costs])]
    clocks = [clock for clock in clocks if len(clock.rows) > 1]
    return Timing(runs, counted, _unequal(measured, counted), tuple(clocks)) if clocks else None


def _cost(spent: ScoresByCell, row: str, reference: str, stated: Mapping[str, float] | None) -> float | None:
    """Seconds of a row over the reference's; None where they share no run, or the table states no cost of one."""
    if stated is not None:
        return stated[row] / stated[reference] if row in spent and row in stated and reference in stated else None
    cells = [cell for cell in spent.get(row, {}) if cell in spent.get(reference, {})]
    if not cells:
        return None
    ours, theirs = (Paired.of({cell: spent[one][cell] for cell in cells}).scenes.mean() for one in (row, reference))
    return float(ours / theirs)


def _unequal(measured: Runs, counted: str) -> str:
    """In what runs differ, or nobody knows, that decides seconds; a sentence, or nothing."""
    found = []
    for name in UNEQUAL:
        known = measured[name].astype(object).where(measured[name].notna(), "unknown").astype(str)
        values = sorted(set(known.str.replace(LONG_COMMIT, r"\1", regex=True) if name == "commit" else known))
        if len(values) > 1 or values == ["unknown"]:
            found.append(f"{name} ({', '.join(values[:MOST])}{' and others' if len(values) > MOST else ''})")
    so = "their own seconds are not used" if counted == STATED else "their seconds hardly compare"
    return f"Runs differ or may differ in {' and '.join(found)}: {so}." if found else ""


# ---- what is told ------------------------------------------------------------------------------------------------------


def seconds_table(time: Timing, scenes: int) -> Printed:
    """A line for every row: its cost, and in each of WORTH_METRICS its gain, that at equal seconds, whether it is on the front."""
    body: list[list[Entry | str]] = []
    for clock in time.clocks:
        for row in clock.rows:
            cells: list[Entry | str] = [row, f"{clock.costs[row]:.2f}" if row in clock.costs else "–"]
            for metric, rows in time.gains.items():
                one = rows[row]
                late = f" {BEYOND}" if one.beyond and one.equal.count else ""
                told = [difference_text(one.gain, metric, scenes), difference_text(one.equal, metric, scenes) + late]
                cells += [*(["–", "–"] if row == clock.reference else told), "yes" if one.front else ""]
            body.append(cells)
    heads = [f"{metric.group} {metric.label}: {what}" for metric in WORTH_METRICS for what in ("gain", "at equal seconds", "front")]
    return Printed(["Row", f"Seconds / {time.clocks[0].short(time.clocks[0].reference)}", *heads], body)


def seconds_records(time: Timing) -> Iterable[Record]:
    """Lines of seconds.csv: every row in each of WORTH_METRICS.

    What is decided at equal seconds is so among all that are judged in a metric; the others have no p-value.
    """
    for metric, found in time.gains.items():
        judged = {row: one.equal.p_value for row, one in found.items() if one.judged}
        survivors = dict(zip(judged, holm([*judged.values()]), strict=True))
        for clock, row in [(one, row) for one in time.clocks for row in one.rows]:
            one = found[row]
            label = {"capture": clock.capture, "row": row, "reference": clock.reference, "metric": metric.key}
            costs = {"counted": time.counted, "cost": clock.costs.get(row), "score": one.score, "front": one.front}
            line: Record = {**label, **costs, "beyond_curve": one.beyond}
            for name, pairs in (("gain", one.gain), ("equal_seconds", one.equal)):
                seeds = pairs.over_seeds
                line |= {name: seeds and seeds.mean, f"{name}_half_width_over_seeds": seeds and seeds.half_width}
                line |= {f"{name}_half_width_over_scenes": seeds and seeds.wider, f"{name}_pairs": pairs.count}
            yield line | {"equal_seconds_p_value": judged.get(row), "equal_seconds_decided": survivors.get(row)}


def points(time: Timing) -> list[Record]:
    """Score against seconds as JSON types: for every capture its ``rows``, the cheapest first, with cost and scores by metric.

    ``front``: metrics in which a row is on the front; ``curve``: whether it is the reference, or that with more work. Captures
    under which the reference has no curve are left out, if others have one.
    """
    tables = {metric.key: rows for metric, rows in time.gains.items()}
    found = []
    for clock in [one for one in time.clocks if len(one.curve) > 1] or time.clocks[:1]:
        rows = [
            {
                "row": row,
                "name": clock.short(row),
                "cost": float(f"{clock.costs[row]:.6g}"),  # never zero, of which there is no logarithm
                "scores": {key: round(score, 4) for key, rows in tables.items() if (score := rows[row].score) is not None},
                "front": [key for key, rows in tables.items() if rows[row].front],
                "curve": row in clock.curve,
            }
            for row in sorted(clock.costs, key=clock.costs.__getitem__)
        ]
        rows = [row for row in rows if row["scores"]]
        found += [{"capture": clock.capture, "reference": clock.short(clock.reference), "rows": rows}] if rows else []
    return found
