"""Everything that the report says, gathered once and printed in several formats; how the runs were made among it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from ia_bench.common.settings import flat
from ia_bench.report.blocks import Block, block
from ia_bench.report.collect import NOT_SCORED, Collection, Runs, finished, name_of, reason_of
from ia_bench.report.seconds import LONG_COMMIT, Timing, points, seconds_table, timing
from ia_bench.report.statistics import OUTCOMES, Estimate, Paired, Verdict, judge, means, paired, side_by_side
from ia_bench.report.table import BOUNDS, RENDERED, PaperRow, Printed, counterparts, paper_rows
from ia_bench.report.worth import Gain, gains
from ia_bench.runs.table import Table
from ia_bench.scores.metrics import MEASURED

MEAN = "mean over scenes"
OF_EACH_RUN = ("seed", "scene", "threads", "rescored_from")
"""Parts of an identity in which the runs of one row may differ: which cell it is, its threads, the run behind a new score."""
MOST = 5
"""So many things that differ are named, with their values; of more, how many there are."""
MADE_BY = {"preset": "presets", "threads": "numbers of threads", "commit": "commits", "cpu": "processors"}
RECORDED = ("preset", "threads", "commit")
"""Of these, what has to be alike for numbers to compare."""
BUSY = 1.25  # programs for each core, from which on they take each other's time


@dataclass(frozen=True)
class Findings:
    """What the runs of one protocol say."""

    protocol: str  # under which all of it was scored, LPIPS net included
    table: Table  # whose rows, scenes, reference, claims and rows of the paper count
    runs: Runs  # in the order of ``rows`` and ``scenes``, failed ones included
    rows: tuple[str, ...]  # their names, those without a run included
    scenes: tuple[str, ...]  # their names
    reference: str | None  # the row that the others are compared with
    counterparts: dict[str, PaperRow]  # row -> the paper's row that it stands for, of those that have one
    notes: tuple[str, ...]  # which rows mix configurations, and what was left out

    @cached_property
    def overall(self) -> Block:
        """Means over scenes."""
        return block(self.runs, self.rows, self.scenes, MEAN)

    @cached_property
    def blocks(self) -> list[Block]:
        """Means over seeds, one block per scene."""
        return [block(self.runs, self.rows, [name], name) for name in self.scenes]

    @property
    def paper(self) -> tuple[PaperRow, ...]:
        """The paper's own rows, where a row stands for one of them."""
        return paper_rows() if self.counterparts else ()

    @cached_property
    def redrawn(self) -> dict[str, dict[str, Estimate | None]]:
        """Row with a renderer of its own -> metric of renders -> what the reference renderer makes of its textures and light."""
        found = {metric.key: means(self.runs, metric.key.replace(".", "_reference_")) for metric in RENDERED}
        rows = {row: {key: values.get(row) for key, values in found.items()} for row in self.rows}
        return {row: values for row, values in rows.items() if any(values.values())}

    @cached_property
    def differences(self) -> dict[str, dict[str, Paired]]:
        """Row -> metric -> row minus ``reference``; nothing without one."""
        scores = {metric.key: side_by_side(self.runs, metric.column) for metric in MEASURED}
        rows = [row for row in self.rows if self.reference not in (None, row)]
        return {row: {key: paired(table, row, str(self.reference)) for key, table in scores.items()} for row in rows}

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """On what the table claims of rows that are here."""
        claims = [claim for claim in self.table.claims if {claim.better, claim.worse} <= set(self.rows)]
        return judge(self.runs, claims, self.scenes)

    @property
    def tally(self) -> str:
        """How the verdicts came out, in a sentence; on orderings of the paper they are with our prior."""
        ours = "With our small prior, on our own scenes, not with those of the paper: " if self.counterparts else ""
        found = Counter(one.outcome for one in self.verdicts)
        return f"{ours}{', '.join(f'{found[outcome]} {outcome}' for outcome in OUTCOMES)}."

    @cached_property
    def gains(self) -> list[Gain]:
        """What rows are worth, where the table photographs its scenes in several ways."""
        return gains(self.runs, self.table)

    @cached_property
    def timing(self) -> Timing | None:
        """What rows cost beside their reference; None where nothing is compared, or took no time."""
        found = timing(self.runs, self.table, self.reference)
        return found if found is not None and points(found) else None  # photographs alone have no score of these

    @cached_property
    def timed(self) -> Printed | None:
        """The table of gains at equal seconds."""
        return None if self.timing is None else seconds_table(self.timing, len(self.scenes))

    @cached_property
    def undefined(self) -> dict[str, str]:
        """Every reason of an undefined score once -> its metrics and runs."""
        found: dict[str, tuple[dict[str, None], dict[str, None]]] = {}
        done = finished(self.runs)
        for metric in MEASURED:
            missing = done[metric.column].isna()
            for run in done[missing].to_dict("records"):
                why = reason_of(run["reasons"], metric.key)
                if why != NOT_SCORED or not missing.all():
                    keys, names = found.setdefault(why, ({}, {}))
                    keys[metric.key] = names[name_of(run)] = None
        return {
            reason: f"{', '.join(keys)} in {'; '.join(names) if len(names) <= 3 else f'{len(names)} runs'}"
            for reason, (keys, names) in found.items()
        }

    @property
    def footnotes(self) -> dict[str, int]:
        """The number of every reason for an undefined value."""
        return {reason: number for number, reason in enumerate(self.undefined, start=1)}

    @property
    def failures(self) -> list[str]:
        """A sentence per failed run."""
        return [f"{name_of(run)}: {run['problem']}" for run in self.runs[self.runs["problem"].notna()].to_dict("records")]

    @cached_property
    def _made(self) -> pd.DataFrame:
        """By what every run was made, as texts; commits are cut to 12 digits, as some records have them."""
        made = self.runs[list(MADE_BY)].astype(object)
        made = made.where(made.notna(), "unknown").astype(str)
        return made.assign(commit=made["commit"].str.replace(LONG_COMMIT, r"\1", regex=True))

    @property
    def warnings(self) -> list[str]:
        """A sentence for everything in which finished runs differ that should be alike, or that nobody could run again."""
        found, done = [], finished(self.runs)
        for name in RECORDED:
            counts = self._made.loc[done.index, name].value_counts()
            if len(counts) > 1:
                said = _some([f"{value} ({count})" for value, count in counts.items()])
                found.append(f"Runs of different {MADE_BY[name]} stand side by side: {said}.")
        for count, what in (
            (done["clean"].eq(False).sum(), "were made by changed code, not by that of a commit"),
            (done["preset"].eq("smoke").sum(), "are of preset=smoke, which shows that everything works, and how well nothing does"),
            (done["load"].gt(BUSY).sum(), "ran beside so much else that their seconds are too many: do not compare them"),
        ):
            if count:
                found.append(f"{count} of {len(done)} runs {what}.")
        return found

    @cached_property
    def made(self) -> dict[str, dict[str, str]]:
        """Row -> its preset, threads and commit, with commas between where its runs differ."""
        rows = {row: self._made.loc[mine.index, list(RECORDED)] for row, mine in self.runs.groupby("row", sort=False)}
        return {row: {name: ", ".join(dict.fromkeys(some[name])) for name in RECORDED} for row, some in rows.items()}

    @property
    def made_apart(self) -> dict[str, dict[str, str]]:
        """Of preset, threads and commit those in which runs differ: its title -> row -> its values."""
        apart = [name for name in RECORDED if self._made[name].nunique() > 1]
        return {name.capitalize(): {row: made[name] for row, made in self.made.items()} for name in apart}

    @property
    def made_alike(self) -> str:
        """The others, in a sentence; empty where there are none."""
        alike = [f"{name} {self._made[name].iloc[0]}" for name in RECORDED if self._made[name].nunique() == 1]
        return f"Every run: {', '.join(alike)}." if alike else ""

    @property
    def origins(self) -> list[tuple[str, ...]]:
        """The ways in which runs were made, the most frequent first: runs, preset, threads, commit, processor, rows."""
        found = []
        for labels, mine in self.runs.groupby([self._made[name] for name in MADE_BY]):
            rows = list(dict.fromkeys(mine["row"]))
            found.append((len(mine), *labels, "all" if len(rows) == self.runs["row"].nunique() else "; ".join(rows)))
        return [(str(count), *rest) for count, *rest in sorted(found, key=lambda one: -one[0])]

    @property
    def bounds(self) -> dict[str, str]:
        """Those rows that bound all others -> what they are."""
        return {row: BOUNDS[row] for row in self.rows if row in BOUNDS}

    @property
    def unranked_seconds(self) -> str:
        """Why seconds rank nothing, in a sentence.

        Empty where all finished runs are known to be of one idle machine, with one number of threads, and measured.
        """
        done = finished(self.runs)
        said = [f"runs are of different {MADE_BY[name]}" for name in ("cpu", "threads") if done[name].nunique() > 1]
        declared = done["declared"].notna() if "declared" in done else pd.Series(False, done.index)
        for which, what in (
            (declared, "{} took what somebody says of them"),
            (done["cpu"].isna() & ~declared, "nobody knows the processor of {}"),
            (done["threads"].isna() & ~declared, "nobody knows the number of threads of {}"),
            (done["load"].isna() & ~declared, "nobody knows what else ran beside {}, of which no load was recorded"),
            (done["load"].gt(BUSY), "{} ran beside too much else"),
        ):
            said += [what.format(f"{which.sum()} of {len(done)} runs")] if which.any() else []
        return f"Seconds rank nothing: {'; '.join(said)}." if said else ""


def analyse(collection: Collection, table: Table | None = None, rows: Sequence[str] | None = None) -> Findings:
    """Gather the findings. Numbers of different protocols do not mix: the most frequent one is kept, the rest is named.

    ``rows``: in their order, those of the table where none are given; others that were found come after them by name, and scenes
    alike. Raises InputError where the paper has no row of the name that the table gives it.
    """
    table = table or Table()
    every = collection.runs
    counted = finished(every)["protocol"].value_counts()  # a runs.csv tells that of failed runs, too
    protocol = str(counted.index[0]) if len(counted) else "(no finished run)"
    foreign = every["problem"].isna() & (every["protocol"] != protocol)
    runs, others = every[~foreign], every[foreign]
    rows = _ordered([row.name for row in table.crossed_rows] if rows is None else rows, runs["row"])
    scenes = _ordered(table.scene_names, runs["scene"])
    places = {"row": rows.index, "scene": scenes.index}
    runs = runs.sort_values(["row", "scene", "seed"], key=lambda one: one.map(places.get(one.name, int))).reset_index(drop=True)
    longer = [row for row in rows if table.compared and row.startswith(f"{table.compared}, ")]  # "none, hull": with its capture
    reference = table.compared if table.compared in rows else longer[0] if len(longer) == 1 else None
    notes = [
        f"{name_of(one)}: left out, scored under {one['protocol']} and not {protocol} ({one['folder']})"
        for one in others.to_dict("records")
    ]
    notes += [f"left out, no record of a run: {problem}" for problem in collection.unreadable]
    notes += _mixed_scenes(runs) + _mixed_rows(runs)
    uncurved = runs[runs["curve_problem"].notna()].to_dict("records")
    notes += [f"{name_of(run)}: no curve: {run['curve_problem']}" for run in uncurved]
    papers = {row: one for row, one in counterparts(table.papers).items() if row in rows}  # the paper left no photographs out
    return Findings(protocol, table, runs, rows, scenes, reference, papers, tuple(notes))


def _ordered(first: Sequence[str], found: Iterable[str]) -> tuple[str, ...]:
    """The names asked for, in their order, then the others that were found, by name."""
    return (*first, *sorted(set(found) - set(first)))


def _mixed_scenes(runs: Runs) -> list[str]:
    """A sentence for every scene of which runs, as far as folders hold their configurations, have read different files."""
    found = []
    for scene, mine in runs.dropna(subset=["setup"]).groupby("scene", sort=False):
        rows: dict[str, dict[str, None]] = {}  # what stands for the files -> the rows that read them
        for row, setup in zip(mine["row"], mine["setup"], strict=True):
            if "scene" in setup.identity:
                rows.setdefault(repr(setup.identity["scene"]), {})[row] = None
        if len(rows) > 1:
            sides = " / ".join(_some([*some]) for some in rows.values())
            found.append(f"{scene}: its runs have read different files under this name, so that they do not compare: {sides}")
    return found


def _mixed_rows(runs: Runs) -> list[str]:
    """A sentence for every row whose runs, as far as folders hold their configurations, differ in more than scene and seed."""
    found = []
    for row, mine in runs.dropna(subset=["setup"]).groupby("row", sort=False):
        tables = []
        for scene, setup in zip(mine["scene"], mine["setup"], strict=True):
            deciding = {key: value for key, value in setup.identity.items() if key not in OF_EACH_RUN}
            tables.append((scene, flat({f"{scene}: reader": deciding.pop("reader", {})} | deciding)))  # scenes may differ in it
        keys = dict.fromkeys(key for _, table in tables for key in table)
        known = {key: [one for scene, one in tables if ": reader" not in key or key.startswith(f"{scene}: ")] for key in keys}
        values = {key: dict.fromkeys(repr(one[key]) if key in one else "nothing" for one in some) for key, some in known.items()}
        if words := [f"{key} ({', '.join(some)})" for key, some in values.items() if len(some) > 1]:
            found.append(f"{row}: its runs are not of one configuration, so that its means mix them: {_some(words)}")
    return found


def _some(words: Sequence[Any]) -> str:
    return ", ".join(words[:MOST]) + (f" and {len(words) - MOST} more" if len(words) > MOST else "")
