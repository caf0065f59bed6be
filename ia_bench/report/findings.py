"""Everything that the report says, gathered once and printed in several formats; how the runs were made among it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.settings import flat
from ia_bench.common.suggestions import listed
from ia_bench.report.collect import Collection, Runs, finished, name_of, reason_of, setup_of
from ia_bench.report.statistics import Block, Estimate, Paired, Verdict, block, judge, means, paired, side_by_side
from ia_bench.report.table import BOUNDS, RENDERED, PaperRow, counterparts, paper_rows
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS

MEAN = "mean over scenes"
OF_EACH_RUN = ("seed", "scene", "threads", "rescored_from")
"""Parts of an identity in which the runs of one row may differ: which cell it is, its threads, the run behind a new score."""
MOST = 5
"""So many things that differ are named, with their values; of more, how many there are."""
MADE_BY = {"preset": "presets", "threads": "numbers of threads", "commit": "commits", "cpu": "processors"}
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Findings:
    """What the runs of one protocol say.

    Attributes:
        protocol: Under which all of it was scored, LPIPS net included.
        runs: In the order of ``rows`` and ``scenes``, failed ones included.
        rows: Their names, those without a run included.
        scenes: Their names.
        overall: Means over scenes.
        blocks: Means over seeds, one block per scene.
        paper: The paper's own rows, where a row stands for one of them.
        counterparts: Row -> the paper's row that it stands for, of those that have one.
        redrawn: Row with a renderer of its own -> metric -> what the reference renderer makes of its textures and light.
        reference: The row that the others are compared with.
        differences: Row -> metric -> row minus ``reference``.
        verdicts: On what the table claims.
        undefined: Reason -> the metrics and runs whose value it explains.
        failures: A sentence per failed run.
        warnings: A sentence for everything that makes runs hard to compare.
        origins: The ways in which runs were made, the most frequent first: runs, preset, threads, commit, processor, rows.
        notes: Which rows mix configurations, and what was left out.
    """

    protocol: str
    runs: Runs
    rows: tuple[str, ...]
    scenes: tuple[str, ...]
    overall: Block
    blocks: tuple[Block, ...]
    paper: tuple[PaperRow, ...]
    counterparts: dict[str, PaperRow]
    redrawn: dict[str, dict[str, Estimate | None]]
    reference: str | None
    differences: dict[str, dict[str, Paired]]
    verdicts: tuple[Verdict, ...]
    undefined: dict[str, str]
    failures: tuple[str, ...]
    warnings: tuple[str, ...]
    origins: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def footnotes(self) -> dict[str, int]:
        """The number of every reason for an undefined value."""
        return {reason: number for number, reason in enumerate(self.undefined, start=1)}

    @property
    def bounds(self) -> dict[str, str]:
        """Those rows that bound all others -> what they are."""
        return {row: BOUNDS[row] for row in self.rows if row in BOUNDS}

    @property
    def seconds_compare(self) -> bool:
        """Whether seconds rank anything: all finished runs are of one machine, with one number of threads."""
        done = finished(self.runs)
        return all(done[name].nunique(dropna=False) <= 1 and done[name].notna().all() for name in ("cpu", "threads"))


def analyse(
    collection: Collection,
    rows_order: Sequence[str] = (),
    scenes_order: Sequence[str] = (),
    reference: str | None = None,
    claims: Sequence[Claim] = (),
    papers: Mapping[str, str] | None = None,
) -> Findings:
    """Gather the findings. Numbers of different protocols do not mix: the most frequent one is kept, the rest is named.

    ``papers``: row -> the paper's row that it stands for.
    Raises InputError where ``reference`` or a row of ``claims`` is no row, and where the paper has no such row.
    """
    every = collection.runs
    counted = every["protocol"].value_counts()
    protocol = str(counted.index[0]) if len(counted) else "(no finished run)"
    foreign = every["problem"].isna() & (every["protocol"] != protocol) & (len(counted) > 0)
    runs, others = every[~foreign], every[foreign]
    rows, scenes = _ordered(rows_order, runs["row"]), _ordered(scenes_order, runs["scene"])
    places = {"row": rows.index, "scene": scenes.index}
    runs = runs.sort_values(["row", "scene", "seed"], key=lambda one: one.map(places.get(one.name, int))).reset_index(drop=True)
    captured = [row for row in rows if row.startswith(f"{reference}, ")]  # "none, hull": a row's name may end with its capture
    if reference not in rows and len(captured) == 1:
        reference = captured[0]
    if reference is not None and reference not in rows:
        raise InputError(f"reference: expected one of the rows {listed(rows)}, found {reference}")
    for row in (row for claim in claims for row in (claim.better, claim.worse)):
        if row not in rows:
            raise InputError(f"claims: expected rows among {listed(rows)}, found {row}")
    stand_for = counterparts(papers or {})
    return Findings(
        protocol=protocol,
        runs=runs,
        rows=rows,
        scenes=scenes,
        overall=block(runs, rows, scenes, MEAN),
        blocks=tuple(block(runs, rows, [name], name) for name in scenes),
        paper=paper_rows() if stand_for else (),
        counterparts=stand_for,
        redrawn=_redrawn(runs, rows),
        reference=reference,
        differences={} if reference is None else _differences(runs, [row for row in rows if row != reference], reference),
        verdicts=tuple(judge(runs, claims, scenes)),
        undefined=_undefined(runs),
        failures=tuple(f"{name_of(run)}: {run['problem']}" for run in _records(runs[runs["problem"].notna()])),
        warnings=tuple(_warnings(finished(runs))),
        origins=tuple(_origins(runs)),
        notes=(
            *_mixed_rows(runs),
            *(
                f"{name_of(one)}: left out, scored under {one['protocol']} and not {protocol} ({one['folder']})"
                for one in _records(others)
            ),
            *(f"left out, no record of a run: {problem}" for problem in collection.unreadable),
            *(f"{name_of(run)}: no curve: {run['curve_problem']}" for run in _records(runs[runs["curve_problem"].notna()])),
        ),
    )


def _ordered(first: Sequence[str], found: Iterable[str]) -> tuple[str, ...]:
    """The names asked for, in their order, then the others that were found, by name."""
    return (*first, *sorted(set(found) - set(first)))


def _records(runs: Runs) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = runs.to_dict("records")
    return found


def _differences(runs: Runs, rows: Sequence[str], reference: str) -> dict[str, dict[str, Paired]]:
    scores = {metric.key: side_by_side(runs, metric) for metric in METRICS}
    return {row: {key: paired(table, row, reference) for key, table in scores.items()} for row in rows}


def _redrawn(runs: Runs, rows: Sequence[str]) -> dict[str, dict[str, Estimate | None]]:
    """What the reference renderer makes of each row in the metrics of renders; without rows that it draws anyway."""
    found = {metric.key: means(runs, metric.key.replace(".", "_reference_")) for metric in RENDERED}
    tables = {row: {key: values.get(row) for key, values in found.items()} for row in rows}
    return {row: values for row, values in tables.items() if any(values.values())}


def _undefined(runs: Runs) -> dict[str, str]:
    """Every reason of an undefined score once, with its metrics and runs."""
    found: dict[str, tuple[dict[str, None], dict[str, None]]] = {}
    done = finished(runs)
    for metric in METRICS:
        for run in _records(done[done[metric.column].isna()]):
            keys, names = found.setdefault(reason_of(run["reasons"], metric.key), ({}, {}))
            keys[metric.key] = names[name_of(run)] = None
    return {
        reason: f"{', '.join(keys)} in {'; '.join(names) if len(names) <= 3 else f'{len(names)} runs'}"
        for reason, (keys, names) in found.items()
    }


def _origins(runs: Runs) -> list[tuple[str, ...]]:
    made = runs[list(MADE_BY)].astype(object).where(runs[list(MADE_BY)].notna(), UNKNOWN).astype(str)
    found = []
    for labels, mine in runs.groupby([made[name] for name in MADE_BY]):
        rows = list(dict.fromkeys(mine["row"]))
        found.append((len(mine), *labels, "all" if len(rows) == runs["row"].nunique() else "; ".join(rows)))
    return [(str(count), *rest) for count, *rest in sorted(found, key=lambda one: -one[0])]


def _warnings(done: Runs) -> list[str]:
    """A sentence for everything in which finished runs differ that should be alike, or that nobody could run again."""
    found = []
    for name in ("preset", "threads", "commit"):
        counts = done[name].astype(object).where(done[name].notna(), UNKNOWN).value_counts()
        if len(counts) > 1:
            said = _some([f"{value} ({count})" for value, count in counts.items()])
            found.append(f"Runs of different {MADE_BY[name]} stand side by side: {said}.")
    dirty = int(done["clean"].eq(False).sum())
    return [*found, f"{dirty} of {len(done)} runs were made by changed code, not by that of a commit."] if dirty else found


def _mixed_rows(runs: Runs) -> list[str]:
    """A sentence for every row whose runs differ in more than scene and seed, naming the settings and their values.

    A run whose folder holds no configuration, as of one that only a runs.csv knows, is passed over.
    """
    found = []
    for row, folders in runs.groupby("row", sort=False)["folder"]:
        setups = [setup for folder in folders.unique() if (setup := setup_of(folder)) is not None]
        tables = [flat({key: value for key, value in one.identity.items() if key not in OF_EACH_RUN}) for one in setups]
        keys = dict.fromkeys(key for table in tables for key in table)
        values = {key: dict.fromkeys(repr(table[key]) if key in table else "nothing" for table in tables) for key in keys}
        if words := [f"{key} ({', '.join(some)})" for key, some in values.items() if len(some) > 1]:
            found.append(f"{row}: its runs are not of one configuration, so that its means mix them: {_some(words)}")
    return found


def _some(words: Sequence[str]) -> str:
    return ", ".join(words[:MOST]) + (f" and {len(words) - MOST} more" if len(words) > MOST else "")
