"""The report's tables as header and cells, which Markdown and LaTeX print alike, and the paper's own table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

from ia_bench.common.errors import InputError
from ia_bench.report.statistics import Block, Estimate, Paired, Verdict
from ia_bench.scores.metrics import METRICS, Metric

BOUNDS = {"ceiling": "ceiling", "constant": "floor"}
"""Rows that optimise nothing and bound all others, and what they are: the truth rendered, and one grey."""
RENDERED = tuple(metric for metric in METRICS if metric.group in ("View synthesis", "Relighting"))  # which depend on who renders
COSTS = ("Seconds", "Peak memory", "Failed")
ORIGINS = ("Runs", "Preset", "Threads", "Commit", "Processor", "Rows")
"""How runs were made: the columns of :attr:`ia_bench.report.findings.Findings.origins`."""
HEADLINE = ("PSNR", "MSE")  # labels of the metrics that are compared with the paper's


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's table 1: ``group`` as the paper divides it, ``values`` by :attr:`Metric.key`."""

    method: str
    group: str
    values: dict[str, float]


@dataclass(frozen=True)
class Entry:
    """One entry: its text, whether it is the best, and the numbers of its footnotes."""

    text: str
    best: bool = False
    notes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Printed:
    """What a format prints: entries that are plain texts need no emphasis."""

    header: Sequence[str]
    body: Sequence[Sequence[Entry | str]]


def paper_rows() -> tuple[PaperRow, ...]:
    """Table 1 of the IntrinsicAnything paper, shipped as data; of the metrics, those that it has."""
    text = resources.files("ia_bench.report").joinpath("paper_table1.csv").read_text(encoding="utf-8")
    return tuple(
        PaperRow(cells["method"], cells["group"], {m.key: float(cells[m.column]) for m in METRICS if m.column in cells})
        for cells in csv.DictReader(io.StringIO(text))
    )


def counterparts(papers: Mapping[str, str]) -> dict[str, PaperRow]:
    """Row -> the paper's row, from row -> its name. Raises InputError where the paper has no such row."""
    printed = {one.method: one for one in paper_rows()}
    for row, name in papers.items():
        if name not in printed:
            raise InputError(f"rows: {row}: paper: expected a row of the paper's table, some of {', '.join(printed)}, found {name}")
    return {row: printed[name] for row, name in papers.items()}


def best_paper_methods(rows: Sequence[PaperRow], metric: Metric) -> set[str]:
    """The methods that the paper prints in bold for this metric: the best, all rows ranked together."""
    best = (max if metric.higher_is_better else min)(row.values[metric.key] for row in rows)
    return {row.method for row in rows if row.values[metric.key] == best}


def estimate_text(value: Estimate | None, metric: Metric, scenes: int) -> str:
    """The mean, the interval where there is one, and the number of scenes where some are missing; – for no value."""
    if value is None:
        return "–"
    interval = "" if value.half_width is None else f" ± {metric.text(value.half_width)}"
    missing = f" ({value.scenes}/{scenes})" if value.scenes < scenes else ""
    return f"{metric.text(value.mean)}{interval}{missing}"


def difference_text(pairs: Paired, metric: Metric, scenes: int = 1) -> str:
    """The mean with its sign, "± over seeds / over scenes" (– where nothing was repeated), ‡ where one pair carries it."""
    value, wider = pairs.over_seeds, pairs.over_scenes
    if value is None or wider is None:
        return "–"
    widths = [value.half_width] if scenes == 1 else [value.half_width, wider.half_width]
    texts = ["–" if width is None else metric.text(width) for width in widths]
    interval = "" if set(texts) == {"–"} else f" ± {' / '.join(texts)}"
    missing = f" ({value.scenes}/{scenes})" if value.scenes < scenes else ""
    return f"{value.mean:+.{metric.digits}f}{interval}{missing}{' ‡' if pairs.carriers else ''}"


def carried_text(pairs: Paired) -> str:
    """Which pairs carry the mean: "seed 2 on console"; empty where none does alone."""
    return ", or ".join(f"seed {seed} on {scene}" for scene, seed in pairs.carriers)


def measured(block: Block) -> list[Metric]:
    """The metrics that some row has; a column without a number is left out."""
    return [metric for metric in METRICS if any(one.values[metric.key] is not None for one in block.lines)]


def left_out(block: Block) -> list[str]:
    """A sentence for every column that is left out, with its reasons: "Roughness MSE: no true roughness"."""
    missing = [metric for metric in METRICS if metric not in measured(block)]
    reasons = {m: dict.fromkeys(reason for one in block.lines for reason in one.reasons[m.key]) for m in missing}
    return [f"{metric.title}: {'; '.join(reasons[metric]) or 'every run failed'}" for metric in missing]


def results_table(block: Block, notes: Mapping[str, int], metrics: Sequence[Metric] = METRICS) -> Printed:
    """The ``metrics`` and costs of every row; ``notes`` numbers the reasons of what is undefined."""
    body = []
    for one in block.lines:
        bound = f" ({BOUNDS[one.row]})" if BOUNDS.get(one.row, one.row) != one.row else ""
        cells: list[Entry | str] = [f"{one.row}{bound}{' †' if one.sees_truth else ''}"]
        for metric in metrics:
            text = estimate_text(one.values[metric.key], metric, block.scenes)
            why = tuple(notes[reason] for reason in one.reasons[metric.key])
            cells.append(Entry(text, block.is_best(one.row, metric), why))
        seconds = "–" if one.seconds is None else f"{one.seconds.mean:.1f}{' (declared)' if one.declared else ''}"
        memory = "–" if one.peak_memory_bytes is None else f"{one.peak_memory_bytes / 2**20:.0f} MiB"
        body.append([*cells, seconds, memory, f"{one.failed}/{one.runs}"])
    return Printed(["Row", *(metric.title for metric in metrics), *COSTS], body)


def paper_table(rows: Sequence[PaperRow]) -> Printed:
    """The paper's figures, as it prints them."""
    metrics = [metric for metric in METRICS if metric.key in rows[0].values]
    best = {metric.key: best_paper_methods(rows, metric) for metric in metrics}
    body: list[list[Entry | str]] = [
        [row.method, *(Entry(metric.text(row.values[metric.key]), row.method in best[metric.key]) for metric in metrics)]
        for row in rows
    ]
    return Printed(["Paper's row", *(metric.title for metric in metrics)], body)


def beside_paper_table(block: Block, counterparts: Mapping[str, PaperRow]) -> Printed:
    """A line per row that stands for one of the paper's: the headline metrics here, and there on the paper's scenes."""
    printed = next(iter(counterparts.values())).values
    metrics = [metric for metric in METRICS if metric.label in HEADLINE and metric.key in printed]
    body = [
        [one.row, counterparts[one.row].method]
        + [
            f"{'–' if (value := one.values[m.key]) is None else m.text(value.mean)} ({m.text(counterparts[one.row].values[m.key])})"
            for m in metrics
        ]
        for one in block.lines
        if one.row in counterparts
    ]
    return Printed(["Row", "Paper's row", *(f"{metric.title} here (paper's scenes)" for metric in metrics)], body)


def redrawn_table(rows: Mapping[str, Mapping[str, Estimate | None]], overall: Block) -> Printed:
    """A line per row with a renderer of its own: each metric of renders by that one, and by the reference renderer."""
    own = {one.row: one.values for one in overall.lines}
    body = [
        [row, *(estimate_text(values[m.key], m, overall.scenes) for m in RENDERED for values in (own[row], reference))]
        for row, reference in rows.items()
    ]
    return Printed(["Row", *(f"{m.title}, {by}" for m in RENDERED for by in ("its own", "reference"))], body)


def differences_table(differences: Mapping[str, Mapping[str, Paired]], scenes: Sequence[str]) -> Printed:
    """A line per row, a column per metric."""
    body = [[row, *(difference_text(values[m.key], m, len(scenes)) for m in METRICS)] for row, values in differences.items()]
    return Printed(["Row", *(metric.title for metric in METRICS)], body)


def claims_table(verdicts: Sequence[Verdict], scenes: Sequence[str]) -> Printed:
    """A line for every two rows and metric: the mean, the outcome, what carries it, and every scene for itself."""
    body = []
    for one in verdicts:
        by_scene = (difference_text(one.pairs.of_scene(scene), one.metric) for scene in scenes)
        mean = difference_text(one.pairs, one.metric, len(scenes)).removesuffix(" ‡")
        names = [f"{one.better} above {one.worse}", one.metric.title]
        body.append([*names, mean, one.outcome, carried_text(one.pairs) or "–", *by_scene])
    return Printed(["Claim", "Metric", "Difference", "Outcome", "Carried by", *scenes], body)
