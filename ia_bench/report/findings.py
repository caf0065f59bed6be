"""Everything that the report says, gathered once and printed in several formats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ia_bench.common.suggestions import listed
from ia_bench.report.claims import Verdict, judge
from ia_bench.report.collect import Collection, Run
from ia_bench.report.configurations import mixed_rows
from ia_bench.report.curves import TimeToError, Worsening, time_to_beat, time_to_error, worsening
from ia_bench.report.statistics import Paired, Redrawn, line, paired, redrawn
from ia_bench.report.table import Block, PaperRow, carried_text, counterparts, paper_rows
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS


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
        paper: The paper's own rows.
        counterparts: Row -> the paper's row that it stands for, of those that have one.
        redrawn: What the reference renderer makes of rows that have another one.
        reference: The row that the others are compared with.
        differences: Row -> metric -> row minus ``reference``.
        verdicts: On what the table claims.
        times: When rows first reach given errors.
        beats: How soon rows are where the reference is at its best.
        worsening: Where more time makes a metric worse.
        undefined: Reason -> the metrics and runs whose value it explains.
        failures: A sentence per failed run.
        notes: Where runs come from, and what was left out.
    """

    protocol: str
    runs: tuple[Run, ...]
    rows: tuple[str, ...]
    scenes: tuple[str, ...]
    overall: Block
    blocks: tuple[Block, ...]
    paper: tuple[PaperRow, ...]
    counterparts: dict[str, PaperRow]
    redrawn: tuple[Redrawn, ...]
    reference: str | None
    differences: dict[str, dict[str, Paired]]
    verdicts: tuple[Verdict, ...]
    times: tuple[TimeToError, ...]
    beats: tuple[TimeToError, ...]
    worsening: tuple[Worsening, ...]
    undefined: dict[str, str]
    failures: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def footnotes(self) -> dict[str, int]:
        """The number of every reason for an undefined value."""
        return {reason: number for number, reason in enumerate(self.undefined, start=1)}

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
    rows_order: Sequence[str],
    scenes_order: Sequence[str],
    reference: str | None,
    claims: Sequence[Claim] = (),
    papers: Mapping[str, str] | None = None,
) -> Findings:
    """Gather the findings. Numbers of different protocols do not mix: the most frequent one is kept, the rest is named.

    ``papers``: row -> the paper's row that it stands for.
    Raises ValueError where ``reference`` or a row of ``claims`` is no row, for a claim about an unknown metric, and where the
    paper has no such row.
    """
    counted = Counter(run.protocol for run in collection.runs if run.protocol is not None)
    protocol = counted.most_common(1)[0][0] if counted else "(no finished run)"
    runs = tuple(run for run in collection.runs if run.protocol in (None, protocol))
    rows, scenes = _ordered(rows_order, (run.row for run in runs)), _ordered(scenes_order, (run.scene for run in runs))
    runs = tuple(sorted(runs, key=lambda run: (rows.index(run.row), scenes.index(run.scene), run.seed)))
    if reference is not None and reference not in rows:
        raise ValueError(f"reference: expected one of the rows {listed(rows)}, found {reference}")
    for row in (row for claim in claims for row in (claim.better, claim.worse)):
        if row not in rows:
            raise ValueError(f"claims: expected rows among {listed(rows)}, found {row}")
    others = [row for row in rows if row != reference] if reference is not None else []
    return Findings(
        protocol=protocol,
        runs=runs,
        rows=rows,
        scenes=scenes,
        overall=Block("mean over scenes", tuple(line(runs, row) for row in rows), len(scenes)),
        blocks=tuple(Block(name, tuple(line([r for r in runs if r.scene == name], row) for row in rows)) for name in scenes),
        paper=paper_rows(),
        counterparts=counterparts(papers or {}),
        redrawn=tuple(found for row in rows if (found := redrawn(runs, row)) is not None),
        reference=reference,
        differences={row: {m.key: paired(runs, row, reference or "", m) for m in METRICS} for row in others},
        verdicts=tuple(judge(runs, claims, scenes)),
        times=tuple(time_to_error(runs)),
        beats=tuple(time_to_beat(runs, reference)) if reference is not None else (),
        worsening=tuple(worsening(runs)),
        undefined=_undefined(runs),
        failures=tuple(f"{run.name}: {run.problem}" for run in runs if run.problem is not None),
        notes=tuple(_notes(collection, runs, protocol)),
    )


def _ordered(first: Sequence[str], found: Iterable[str]) -> tuple[str, ...]:
    """The names asked for, in their order, then the others that were found, by name."""
    return (*first, *sorted(set(found) - set(first)))


def _notes(collection: Collection, kept: Sequence[Run], protocol: str) -> list[str]:
    """Where runs come from, which rows mix configurations, what was left out and why, unreadable curves."""
    origins = Counter((run.about.get("commit"), run.about.get("cpu")) for run in kept)
    notes = [
        f"{count} {'run' if count == 1 else 'runs'} of commit {commit or 'unknown'} on {cpu or 'an unknown processor'}"
        for (commit, cpu), count in origins.most_common()
        if commit is not None or cpu is not None
    ]
    notes += mixed_rows(kept)
    notes += [
        f"{run.name}: left out, scored under {run.protocol} and not {protocol} ({run.folder})"
        for run in collection.runs
        if run.protocol not in (None, protocol)
    ]
    notes += [f"left out, no record of a run: {problem}" for problem in collection.unreadable]
    return notes + [f"{run.name}: no curve: {run.curve_problem}" for run in kept if run.curve_problem]


def _undefined(runs: Sequence[Run]) -> dict[str, str]:
    """Every reason of a null once, with its metrics and runs."""
    found: dict[str, list[tuple[str, Run]]] = {}
    for run in runs:
        for key, value in run.metrics.items():
            if value is None:
                found.setdefault(run.reason(key), []).append((key, run))
    texts = {}
    for reason, where in found.items():
        names = list(dict.fromkeys(run.name for _, run in where))
        keys = ", ".join(dict.fromkeys(key for key, _ in where))
        texts[reason] = f"{keys} in {'; '.join(names) if len(names) <= 3 else f'{len(names)} runs'}"
    return texts
