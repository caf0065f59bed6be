"""Everything that the report says, gathered once and printed in several formats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.suggestions import listed
from ia_bench.report.claims import Verdict, judge
from ia_bench.report.collect import Collection, Runs, name_of, reason_of
from ia_bench.report.origins import Origin, mixed_rows, origins, warnings
from ia_bench.report.statistics import Block, Estimate, Paired, block, means, paired, side_by_side
from ia_bench.report.table import BOUNDS, RENDERED, PaperRow, carried_text, counterparts, paper_rows
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS

MEAN = "mean over scenes"


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
        origins: How the runs were made.
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
    origins: tuple[Origin, ...]
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
    def carried(self) -> list[str]:
        """A sentence for every difference that one run carries."""
        return [
            f"{row}, {metric.title}: carried by {carried_text(values[metric.key])}"
            for row, values in self.differences.items()
            for metric in METRICS
            if values[metric.key].carriers
        ]


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
        warnings=tuple(warnings(runs)),
        origins=tuple(origins(runs)),
        notes=(
            *mixed_rows(runs),
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
    found: dict[str, list[tuple[str, str]]] = {}
    for run in _records(runs[runs["problem"].isna()]):
        for metric in METRICS:
            if np.isnan(run[metric.column]):
                found.setdefault(reason_of(run["reasons"], metric.key), []).append((metric.key, name_of(run)))
    texts = {}
    for reason, where in found.items():
        names = list(dict.fromkeys(name for _, name in where))
        keys = ", ".join(dict.fromkeys(key for key, _ in where))
        texts[reason] = f"{keys} in {'; '.join(names) if len(names) <= 3 else f'{len(names)} runs'}"
    return texts
