"""Everything that the report says, gathered once and printed in several formats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ia_bench.report.claims import Verdict, judge
from ia_bench.report.collect import Collection, Run
from ia_bench.report.curves import TimeToError, Worsening, time_to_beat, time_to_error, worsening
from ia_bench.report.statistics import Estimate, paired_difference
from ia_bench.report.table import Results, summarise
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS


@dataclass(frozen=True)
class Findings:
    """``runs`` of one protocol in the order of ``rows`` and ``scenes``, and what follows from them.

    ``differences``: row -> metric -> row minus ``reference``, scenes paired; ``beats``: how soon rows are where the reference
    is at its best. ``verdicts``: on what the table claims. ``failures`` and ``notes`` are sentences.
    """

    runs: tuple[Run, ...]
    rows: tuple[str, ...]
    scenes: tuple[str, ...]
    results: Results
    reference: str | None
    differences: dict[str, dict[str, Estimate | None]]
    verdicts: tuple[Verdict, ...]
    times: tuple[TimeToError, ...]
    beats: tuple[TimeToError, ...]
    worsening: tuple[Worsening, ...]
    failures: tuple[str, ...]
    notes: tuple[str, ...]


def analyse(
    collection: Collection,
    rows_order: Sequence[str],
    scenes_order: Sequence[str],
    reference: str | None,
    claims: Sequence[Claim] = (),
) -> Findings:
    """Gather the findings. Numbers of different protocols do not mix: the most frequent one is kept, the rest is named.

    Raises ValueError where ``reference`` or a row of ``claims`` is no row, and for a claim about an unknown metric.
    """
    counted = Counter(run.protocol for run in collection.runs if run.protocol is not None)
    protocol = counted.most_common(1)[0][0] if counted else "(no finished run)"
    runs = tuple(run for run in collection.runs if run.protocol in (None, protocol))
    rows, scenes = _ordered(rows_order, (run.row for run in runs)), _ordered(scenes_order, (run.scene for run in runs))
    runs = tuple(sorted(runs, key=lambda run: (rows.index(run.row), scenes.index(run.scene), run.seed)))
    if reference is not None and reference not in rows:
        raise ValueError(f"reference: expected one of the rows {', '.join(rows)}, found {reference}")
    for row in (row for claim in claims for row in (claim.better, claim.worse)):
        if row not in rows:
            raise ValueError(f"claims: expected rows among {', '.join(rows)}, found {row}")
    return Findings(
        runs=runs,
        rows=rows,
        scenes=scenes,
        results=summarise(runs, rows, scenes, protocol),
        reference=reference,
        differences=_differences(runs, rows, reference),
        verdicts=tuple(judge(runs, claims, scenes)),
        times=tuple(time_to_error(runs)),
        beats=tuple(time_to_beat(runs, reference)) if reference is not None else (),
        worsening=tuple(worsening(runs)),
        failures=(
            *(f"{_cell(run)}: {run.problem}" for run in runs if run.problem is not None),
            *(f"unknown cell: {problem}" for _, problem in collection.unreadable),
        ),
        notes=tuple(_notes(collection.runs, runs, protocol)),
    )


def _ordered(first: Sequence[str], found: Iterable[str]) -> tuple[str, ...]:
    """The names asked for, in their order, then the others that were found, by name."""
    return (*first, *sorted(set(found) - set(first)))


def _differences(
    runs: Sequence[Run], rows: Sequence[str], reference: str | None
) -> dict[str, dict[str, Estimate | None]]:
    if reference is None:
        return {}
    others = [row for row in rows if row != reference]
    return {row: {m.key: paired_difference(runs, row, reference, m) for m in METRICS} for row in others}


def _notes(found: Sequence[Run], kept: Sequence[Run], protocol: str) -> list[str]:
    """Where runs come from, runs left out, unreadable curves, the reason of every null, each once with its number of runs."""
    origins = Counter((run.commit, run.cpu) for run in kept if run.commit is not None or run.cpu is not None)
    notes = [
        f"{count} {'run' if count == 1 else 'runs'} of commit {commit or 'unknown'} on {cpu or 'an unknown processor'}"
        for (commit, cpu), count in origins.most_common()
    ]
    notes += [
        f"{_cell(run)}: left out, scored under {run.protocol} and not {protocol} ({run.folder})"
        for run in found
        if run.protocol not in (None, protocol)
    ]
    notes += [f"{_cell(run)}: no curve: {run.curve_problem}" for run in kept if run.curve_problem]
    nulls: dict[str, list[tuple[str, Run]]] = {}
    for run in kept:
        for key, value in run.metrics.items():
            if value is None:
                nulls.setdefault(run.reasons.get(key, "no reason given"), []).append((key, run))
    for reason, where in nulls.items():
        keys = ", ".join(dict.fromkeys(key for key, _ in where))
        cells = list(dict.fromkeys(_cell(run) for _, run in where))
        named = "; ".join(cells) if len(cells) <= 3 else f"{len(cells)} runs"
        notes.append(f"{keys} undefined in {named}: {reason}")
    return notes


def _cell(run: Run) -> str:
    return f"{run.row}, {run.scene}, seed {run.seed}"
