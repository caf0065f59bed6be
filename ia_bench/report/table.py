"""The report's tables as header and cells, which Markdown and LaTeX print alike, and the paper's own table.

A metric that is new is shown as its group says: those of the paper and of the light stand in the main tables, every other group
has a table of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from ia_bench.common.errors import InputError
from ia_bench.common.paths import PACKAGE
from ia_bench.report.blocks import PSNRS, Block, Line
from ia_bench.report.collect import NOT_SCORED
from ia_bench.report.statistics import Estimate, Paired, Verdict
from ia_bench.scores.metrics import MEASURED, METRICS, Metric

BOUNDS = {"ceiling": "ceiling", "constant": "floor"}
"""Rows that optimise nothing and bound all others, and what they are: the truth rendered, and one grey."""
RENDERED = tuple(metric for metric in METRICS if metric.group in ("View synthesis", "Relighting"))  # which depend on who renders
COSTS = ("Seconds", "Peak memory", "Failed")
ORIGINS = ("Runs", "Preset", "Threads", "Commit", "Processor", "Rows")
"""How runs were made: the columns of :attr:`ia_bench.report.findings.Findings.origins`."""
HEADLINE = ("PSNR", "MSE")  # labels of the metrics that are compared with the paper's
MAIN = tuple(metric for metric in MEASURED if metric.group == "Light" or metric in METRICS and metric.label in HEADLINE)
"""What a table is read by first."""
FURTHER = tuple(metric for metric in MEASURED if metric not in (*METRICS, *MAIN))
PARTS = {
    "": MAIN,
    "SSIM and LPIPS": tuple(metric for metric in METRICS if metric not in MAIN),
    **{group: tuple(metric for metric in FURTHER if metric.group == group) for group in dict.fromkeys(m.group for m in FURTHER)},
}
"""Title of a part of the results, the main one without -> its metrics."""
OUR_TABLE = """\
This is our table after the paper's table 1. Its scenes are our own objects (our hat and ship are not the
paper's), and renderer, protocol and priors, which are small, are ours too."""
"""What stands first where rows stand for the paper's."""


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
    lines = pd.read_csv(PACKAGE / "report" / "paper_table1.csv").to_dict("records")
    return tuple(PaperRow(one["method"], one["group"], {m.key: one[m.column] for m in METRICS if m.column in one}) for one in lines)


def counterparts(papers: Mapping[str, str]) -> dict[str, PaperRow]:
    """Row -> the paper's row, from row -> its name. Raises InputError where the paper has no such row."""
    printed = {one.method: one for one in paper_rows()}
    for row, name in papers.items():
        if name not in printed:
            raise InputError(f"rows: {row}: paper: expected a row of the paper's table, some of {', '.join(printed)}, found {name}")
    return {row: printed[name] for row, name in papers.items()}


def seconds_text(one: Line, scenes: int) -> str:
    """Seconds of a row, the number of scenes where some are missing, and whether they are what somebody says."""
    value = one.seconds
    return "–" if value is None else f"{value.mean:.1f}{_missing(value, scenes)}{' (declared)' if one.declared else ''}"


def estimate_text(value: Estimate | None, metric: Metric, scenes: int, *, widths: bool = True) -> str:
    """The mean, "± over seeds / over scenes" with ``widths``, and the number of scenes where some are missing; – for no value."""
    if value is None:
        return "–"
    return metric.text(value.mean) + _widths(value, metric, scenes, *((value.half_width, value.wider) if widths else ()))


def difference_text(pairs: Paired, metric: Metric, scenes: int = 1) -> str:
    """The mean with its sign, "± over seeds / over scenes / new scene", ‡ where one pair carries it."""
    value = pairs.over_seeds
    if value is None:
        return "–"
    widths = _widths(value, metric, scenes, value.half_width, value.wider, pairs.new_scene)
    return f"{value.mean:+.{metric.digits}f}{widths}{' ‡' if pairs.carriers else ''}"


def _widths(value: Estimate, metric: Metric, scenes: int, *widths: float | None) -> str:
    """Half widths as " ± 0.12 / 0.80", of a single scene the first alone, – for None; " (3/4)" behind where scenes are missing."""
    texts = ["–" if width is None else metric.text(width) for width in (widths[:1] if scenes == 1 else widths)]
    return ("" if set(texts) <= {"–"} else f" ± {' / '.join(texts)}") + _missing(value, scenes)


def _missing(value: Estimate, scenes: int) -> str:
    """Over how many of the ``scenes`` a mean is, where it is not over all of them."""
    return f" ({value.scenes}/{scenes})" if value.scenes < scenes else ""


def p_text(value: float | None) -> str:
    """A p-value with two digits, – for none."""
    return "–" if value is None else "< 0.0001" if value < 1e-4 else f"{value:.2g}"


def signs_text(pairs: Paired) -> str:
    """In how many scenes the difference is above zero, with the sign test's p-value: "7 of 8 (p 0.07)"; – for too few scenes."""
    return "–" if pairs.signs is None else "{} of {} (p {})".format(*pairs.signs[:2], p_text(pairs.signs[2]))


def carried_text(pairs: Paired) -> str:
    """Which pairs carry the mean: "seed 2 on console"; empty where none does alone."""
    return ", or ".join(f"seed {seed} on {scene}" for scene, seed in pairs.carriers)


def measured(block: Block, metrics: Sequence[Metric] = MEASURED) -> list[Metric]:
    """Those of the metrics that some row has; a column without a number is left out."""
    return [metric for metric in metrics if any(one.values[metric.key] is not None for one in block.lines)]


def left_out(block: Block) -> list[str]:
    """The columns that are left out, those with the same reasons together: "Roughness MSE ↓: no true roughness"."""
    found: dict[str, list[str]] = {}
    without = "every run failed" if any(one.runs for one in block.lines) else "no run is here"
    for metric in (one for one in MEASURED if one not in measured(block)):
        reasons = dict.fromkeys(reason for one in block.lines for reason in one.reasons[metric.key])
        if metric in METRICS or {*reasons} - {NOT_SCORED}:  # of what is newer than all records nobody has to know
            found.setdefault("; ".join(reasons) or without, []).append(metric.title)
    return [f"{', '.join(titles)}: {reason}" for reason, titles in found.items()]


def parts(block: Block) -> list[tuple[str, list[Metric]]]:
    """The PARTS that some row has a number of."""
    return [(title, some) for title, metrics in PARTS.items() if (some := measured(block, metrics))]


def results_table(
    block: Block,
    notes: Mapping[str, int],
    metrics: Sequence[Metric] = MAIN,
    made: Mapping[str, Mapping[str, str]] | None = None,
    widths: bool = True,
) -> Printed:
    """The ``metrics`` of every row; ``notes`` numbers the reasons of what is undefined.

    ``made``: title of a further column -> row -> its text, behind what the row costs; None: neither costs nor these. ``widths``:
    whether means have their intervals.
    """
    body = []
    for one in block.lines:
        bound = f" ({BOUNDS[one.row]})" if BOUNDS.get(one.row, one.row) != one.row else ""
        cells: list[Entry | str] = [f"{one.row}{bound}{' †' if one.sees_truth else ''}"]
        for metric in metrics:
            text = estimate_text(one.values[metric.key], metric, block.scenes, widths=widths)
            why = tuple(notes[reason] for reason in one.reasons[metric.key] if reason in notes)
            cells.append(Entry(text, block.is_best(one.row, metric), why))
        if made is not None:
            memory = "–" if one.peak_memory_bytes is None else f"{one.peak_memory_bytes / 2**20:.0f} MiB"
            cells += [seconds_text(one, block.scenes), memory, f"{one.failed}/{one.runs}"]
            cells += [texts.get(one.row, "–") for texts in made.values()]
        body.append(cells)
    more = [] if made is None else [*COSTS, *made]
    return Printed(["Row", *map(_head, metrics), *more], body)


def _head(metric: Metric) -> str:
    """What stands above a metric's column; in the table of its group, the group is its title."""
    return f"{metric.label} {metric.arrow}" if metric in FURTHER else metric.title


def paper_table(rows: Sequence[PaperRow]) -> Printed:
    """The paper's figures as it prints them, in bold the best of all rows."""
    metrics = [metric for metric in METRICS if metric.key in rows[0].values]
    best = {m: (max if m.higher_is_better else min)(row.values[m.key] for row in rows) for m in metrics}
    body: list[list[Entry | str]] = [
        [row.method, *(Entry(m.text(row.values[m.key]), row.values[m.key] == best[m]) for m in metrics)] for row in rows
    ]
    return Printed(["Paper's row", *(metric.title for metric in metrics)], body)


def beside_paper_table(block: Block, counterparts: Mapping[str, PaperRow]) -> Printed:
    """A line per row that stands for one of the paper's: the headline metrics here, and there on the paper's scenes."""
    printed = next(iter(counterparts.values())).values
    metrics = [metric for metric in METRICS if metric.label in HEADLINE and metric.key in printed]
    body = []
    for one in [line for line in block.lines if line.row in counterparts]:
        theirs = counterparts[one.row]
        here = {m: [one.values[m.key], *([one.whole[m.key]] if m in PSNRS else [])] for m in metrics}
        texts = {m: " / ".join(estimate_text(value, m, block.scenes, widths=False) for value in some) for m, some in here.items()}
        body.append([one.row, theirs.method, *(f"{text} ({m.text(theirs.values[m.key])})" for m, text in texts.items())])
    heads = (f"{m.title} {'object / whole image' if m in PSNRS else 'here'} (paper's scenes)" for m in metrics)
    return Printed(["Row", "Paper's row", *heads], body)


def whole_table(block: Block) -> Printed:
    """Every PSNR that some row has over the object's pixels, and over whole images; nothing where no run has the latter."""
    rows = {one.row: (one.values, one.whole) for one in block.lines if any(one.whole.values())}
    return _two_ways(rows, measured(block, PSNRS), ("object", "whole image"), block.scenes)


def redrawn_table(redrawn: Mapping[str, Mapping[str, Estimate | None]], overall: Block) -> Printed:
    """A line per row with a renderer of its own: each metric of renders by that one, and by the reference renderer."""
    own = {one.row: one.values for one in overall.lines}
    rows = {row: (own[row], reference) for row, reference in redrawn.items()}
    return _two_ways(rows, RENDERED, ("its own", "reference"), overall.scenes)


def _two_ways(
    rows: Mapping[str, Sequence[Mapping[str, Estimate | None]]], metrics: Sequence[Metric], ways: Sequence[str], scenes: int
) -> Printed:
    """A line per row, and each metric in two ways."""
    heads = [f"{metric.title}, {way}" for metric in metrics for way in ways]
    texts = {row: [estimate_text(one[m.key], m, scenes) for m in metrics for one in values] for row, values in rows.items()}
    return Printed(["Row", *heads], [[row, *cells] for row, cells in texts.items()])


def differences_table(differences: Mapping[str, Mapping[str, Paired]], scenes: Sequence[str]) -> list[tuple[str, Printed]]:
    """Title of a part of the results -> a line per row, a column per metric that some row has a difference in."""
    found = []
    for title, part in PARTS.items():
        if metrics := [metric for metric in part if any(values[metric.key].pairs for values in differences.values())]:
            texts = {row: [difference_text(values[m.key], m, len(scenes)) for m in metrics] for row, values in differences.items()}
            head = ["Row", *map(_head, metrics)]
            found.append((title, Printed(head, [[row, *cells] for row, cells in texts.items()])))
    return found


def claims_table(verdicts: Sequence[Verdict], scenes: Sequence[str], *, by_scene: bool = True) -> Printed:
    """A line for every two rows and metric: the mean over ``scenes``, the outcome, what carries it, and each scene for itself."""
    body, signs, shown = [], any(one.pairs.signs for one in verdicts), scenes if by_scene else ()
    for one in verdicts:
        each = (difference_text(one.pairs.of_scene(scene), one.metric) for scene in shown)
        mean = difference_text(one.pairs, one.metric, len(scenes)).removesuffix(" ‡")
        names = [f"{one.better} above {one.worse}", one.metric.title]
        tests = [p_text(one.p_value), *([signs_text(one.pairs)] if signs else [])]
        body.append([*names, mean, one.outcome, carried_text(one.pairs) or "–", *tests, *each])
    tests = ["p", *(["Scenes above (sign test)"] if signs else [])]
    return Printed(["Claim", "Metric", "Difference", "Verdict", "Carried by", *tests, *shown], body)
