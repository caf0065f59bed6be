"""What changed since a former report: the same cells in both, what came and what went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.report.collect import CELL, Runs, as_table, finished, name_of, read_published
from ia_bench.report.findings import MEAN
from ia_bench.report.statistics import Estimate, means
from ia_bench.scores.columns import METRICS, Metric

RUNS = "runs.csv"
BEFORE = "_before"  # ends the columns of the former report


@dataclass(frozen=True)
class Former:
    """A former report: what it is called, and its runs."""

    name: str
    runs: Runs


@dataclass(frozen=True)
class Change:
    """A mean over the scenes and seeds that finished in both reports, when it differs. ``scope``: a scene, or all of them."""

    scope: str
    row: str
    metric: Metric
    before: Estimate
    after: Estimate

    @property
    def gain(self) -> float:
        """How much better it is now, negative where it is worse."""
        difference = self.after.mean - self.before.mean
        return difference if self.metric.higher_is_better else -difference

    @property
    def beyond_seeds(self) -> bool:
        """Whether the two 95 % intervals do not touch. False where one is missing."""
        widths = self.before.half_width, self.after.half_width
        return None not in widths and abs(self.gain) > sum(width or 0.0 for width in widths)


@dataclass(frozen=True)
class Changes:
    """Two reports side by side.

    Attributes:
        former: What the former report is called.
        changed: Means that differ in the digits that are printed, by scene and row.
        same: How many means do not.
        came: Rows and scenes that the former report has not.
        went: Those that only it has.
        drifted: Runs of one configuration hash whose scores differ all the same.
        protocols: Both protocols, where they differ: numbers of two protocols are no change.
    """

    former: str
    changed: tuple[Change, ...]
    same: int
    came: tuple[str, ...]
    went: tuple[str, ...]
    drifted: tuple[str, ...]
    protocols: tuple[str, ...]


def read_former(folder: Path) -> Former:
    """A former report, given its folder or that of its page. Raises InputError where there is none, or one that cannot be read.

    It is read before the new report is written, which may go into the same folder.
    """
    for place in (folder, folder.parent):
        if (place / RUNS).is_file():
            return Former(place.resolve().name, as_table(read_published(place / RUNS)))
    raise InputError(f"--against: {folder}: expected the folder of a report, with its {RUNS}, found none")


def changes(former: Former, runs: Runs, rows: Sequence[str], scenes: Sequence[str]) -> Changes:
    """Compare ``runs`` with those of a former report."""
    both = finished(former.runs).merge(finished(runs), on=list(CELL), suffixes=(BEFORE, ""))
    shared = [scene for scene in scenes if (former.runs["scene"] == scene).any()]
    changed: list[Change] = []
    same = 0
    for scope in (*shared, *([MEAN] if len(shared) > 1 else [])):
        here = both[both["scene"].isin([scope] if scope in shared else shared)]
        for metric in METRICS:
            column = metric.column
            known = here.dropna(subset=[column, column + BEFORE])
            before, after = means(known, column + BEFORE), means(known, column)
            for row, new in after.items():
                old = before[row]
                if old is None or new is None:
                    continue
                if metric.text(old.mean) == metric.text(new.mean):
                    same += 1
                else:
                    changed.append(Change(scope, row, metric, old, new))
    order = {row: place for place, row in enumerate(rows)}
    changed.sort(key=lambda one: ((*shared, MEAN).index(one.scope), order.get(one.row, 0)))
    ours, theirs = ({*zip(found["row"], found["scene"], strict=True)} for found in (runs, former.runs))
    protocols = {*runs["protocol"].dropna(), *former.runs["protocol"].dropna()}
    same_hash = both[both["config_hash"].notna() & (both["config_hash"] == both[f"config_hash{BEFORE}"])].to_dict("records")
    drifted = [run for run in same_hash if any(m.text(run[m.column]) != m.text(run[m.column + BEFORE]) for m in METRICS)]
    return Changes(
        former=former.name,
        changed=tuple(changed),
        same=same,
        came=tuple(f"{row} on {scene}" for row, scene in sorted(ours - theirs)),
        went=tuple(f"{row} on {scene}" for row, scene in sorted(theirs - ours)),
        drifted=tuple(map(name_of, drifted)),
        protocols=tuple(sorted(protocols)) if len(protocols) > 1 else (),
    )
