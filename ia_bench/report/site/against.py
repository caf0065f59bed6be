"""What changed since a former report: the same cells in both, what came and what went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.report.collect import Run
from ia_bench.report.published import read_published
from ia_bench.report.statistics import Estimate, over_scenes
from ia_bench.scores.columns import METRICS, Metric

RUNS = "runs.csv"
CellKey = tuple[str, int]  # scene, seed


@dataclass(frozen=True)
class Former:
    """A former report: what it is called, and its runs."""

    name: str
    runs: tuple[Run, ...]


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
        changed: Means that differ in the digits that are printed, by row.
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
            return Former(place.resolve().name, tuple(read_published(place / RUNS)))
    raise InputError(f"--against: {folder}: expected the folder of a report, with its {RUNS}, found none")


def changes(former: Former, runs: Sequence[Run], rows: Sequence[str], scenes: Sequence[str]) -> Changes:
    """Compare ``runs`` with those of a former report."""
    before = former.runs
    shared = [scene for scene in scenes if any(run.scene == scene for run in before)]
    changed: list[Change] = []
    same = 0
    for scope in (*shared, *(["mean over scenes"] if len(shared) > 1 else [])):
        wanted = [scope] if scope in shared else shared
        for row in rows:
            cells = {cell: pair for cell, pair in _in_both(before, runs, row).items() if cell[0] in wanted}
            for metric in METRICS:
                one, other = _means(cells, metric)
                if one is None or other is None:
                    continue
                if metric.text(one.mean) == metric.text(other.mean):
                    same += 1
                else:
                    changed.append(Change(scope, row, metric, one, other))
    ours, theirs = ({(run.row, run.scene) for run in found} for found in (runs, before))
    protocols = {run.protocol for run in (*before, *runs) if run.protocol is not None}
    return Changes(
        former=former.name,
        changed=tuple(changed),
        same=same,
        came=tuple(f"{row} on {scene}" for row, scene in sorted(ours - theirs)),
        went=tuple(f"{row} on {scene}" for row, scene in sorted(theirs - ours)),
        drifted=tuple(_drifted(before, runs)),
        protocols=tuple(sorted(protocols)) if len(protocols) > 1 else (),
    )


def _in_both(before: Sequence[Run], after: Sequence[Run], row: str) -> dict[CellKey, tuple[Run, Run]]:
    """The scenes and seeds of a row that have finished in both reports, with both runs: means over other cells are no change."""
    old, new = (
        {(run.scene, run.seed): run for run in found if run.row == row and run.problem is None} for found in (before, after)
    )
    return {cell: (old[cell], new[cell]) for cell in old if cell in new}


def _means(cells: Mapping[CellKey, tuple[Run, Run]], metric: Metric) -> tuple[Estimate | None, Estimate | None]:
    """The mean of the former report and that of this one, over the cells that have a value in both; None where none has."""
    scenes: dict[str, list[tuple[float, float]]] = {}
    for (scene, _), (old, new) in cells.items():
        values = old.metrics[metric.key], new.metrics[metric.key]
        if values[0] is not None and values[1] is not None:
            scenes.setdefault(scene, []).append((values[0], values[1]))
    former, later = (over_scenes([[pair[side] for pair in pairs] for pairs in scenes.values()]) for side in (0, 1))
    return former, later


def _drifted(before: Sequence[Run], after: Sequence[Run]) -> list[str]:
    """Finished runs with one hash and other scores: the code, the machine or its libraries changed beneath them."""
    known = {run.about.get("config_hash"): run for run in before if run.problem is None and run.about.get("config_hash")}
    found = []
    for run in after:
        old = known.get(run.about.get("config_hash"))
        if old is None or run.problem is not None:
            continue
        values = ((metric, old.metrics.get(metric.key), run.metrics.get(metric.key)) for metric in METRICS)
        if any((a is None) != (b is None) or (a is not None and b is not None and m.text(a) != m.text(b)) for m, a, b in values):
            found.append(run.name)
    return found
