"""The report to read: report.md, from :class:`Findings`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ia_bench.report.curves import WORSE_DB, seconds_text
from ia_bench.report.findings import Findings
from ia_bench.report.statistics import best_rows
from ia_bench.report.table import PAPER_TITLE, Block, PaperRow, best_paper_methods, cost_texts, estimate_text
from ia_bench.scores.columns import METRICS

NOTES = """\
Means are per image, then over images, seeds and scenes; ± is the 95 % interval over seeds. Bold: the best row that does
not see the ground truth and has every scene. † sees the ground truth and is not ranked. – is undefined, with its reason
below. (3/4): the mean over 3 of 4 scenes, not ranked. Seconds: baking, prior and fit, without scoring. Failed: failed runs
of all runs; they enter no mean."""
TIMES_NOTE = "Seconds of optimisation until a measured point first is at or beyond the level."
BEATS_NOTE = """\
Seconds of optimisation, those of the prior included, until a measured point first is at or beyond the best that {reference}
has on the scene at any time."""
CLAIMS_NOTE = """\
A row is claimed to be above another one. The difference is positive where it is, seed by seed on the same scenes, with the 95 %
interval over seeds: reproduced above zero, not reproduced below it, undecided around it or without an interval. Every line is
judged alone, without a correction for their number."""
WORSENING_NOTE = f"""\
Final against best value of every curve, mean over seeds, where at least {WORSE_DB:g} dB are lost (for a squared error,
10 log10 of final over best)."""


def report_text(findings: Findings, pictures: Sequence[str]) -> str:
    """The whole report. ``pictures`` are the figures' paths relative to the report."""
    results = findings.results
    parts = [
        "# Results",
        f"Protocol {results.protocol}.",
        NOTES,
        f"## Mean over {results.overall.scenes} scenes",
        markdown_block(results.overall),
        f"### {PAPER_TITLE}",
        markdown_paper(results.paper),
    ]
    for block in results.scenes:
        parts += [f"## Scene {markdown_escape(block.title)}", markdown_block(block)]
    parts += _differences(findings)
    parts += _claims(findings)
    if pictures:
        parts += ["## Error against run time", *(f"![{Path(name).stem}]({name})" for name in pictures)]
        parts += ["Curves score fewer views than the tables do. A band reaches from the lowest to the highest seed."]
    parts += _beats(findings)
    parts += _times(findings)
    parts += ["## Where more time makes it worse", WORSENING_NOTE, _worsening(findings)]
    parts += ["## Failed runs", _bullets(findings.failures, "None.")]
    parts += ["## Notes", _bullets(findings.notes, "None.")]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def markdown_block(block: Block) -> str:
    """One Markdown table; best in bold, † behind rows that see the truth."""
    header = ["Row", *(metric.title for metric in METRICS), "Seconds", "Peak memory", "Failed"]
    best = {metric.key: best_rows(block.lines, metric, block.scenes) for metric in METRICS}
    body = []
    for one in block.lines:
        cells = [f"{markdown_escape(one.row)}{' †' if one.sees_truth else ''}"]
        for metric in METRICS:
            text = estimate_text(one.values[metric.key], metric, block.scenes)
            cells.append(f"**{text}**" if one.row in best[metric.key] else text)
        body.append([*cells, *cost_texts(one)])
    return markdown_table(header, body)


def markdown_paper(rows: Sequence[PaperRow]) -> str:
    """The paper's block in Markdown."""
    best = {metric.key: best_paper_methods(rows, metric) for metric in METRICS}
    body = []
    for row in rows:
        texts = [(metric.text(row.values[metric.key]), row.method in best[metric.key]) for metric in METRICS]
        body.append([markdown_escape(row.method), *(f"**{text}**" if bold else text for text, bold in texts)])
    return markdown_table(["Paper's row", *(metric.title for metric in METRICS)], body)


def markdown_table(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A pipe table, first column to the left, the others to the right."""
    rule = [":---", *["---:"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, rule, *body)) + "\n"


def markdown_escape(text: str) -> str:
    """Keep a name from being read as markup."""
    return "".join(f"\\{letter}" if letter in "\\`*_|[]<>" else letter for letter in text)


def _differences(findings: Findings) -> list[str]:
    if not findings.differences:
        return []
    header = ["Row", *(metric.title for metric in METRICS)]
    body = []
    for row, values in findings.differences.items():
        cells = [estimate_text(values[m.key], m, len(findings.scenes)) for m in METRICS]
        body.append([markdown_escape(row), *cells])
    title = f"## Difference to {markdown_escape(findings.reference or '')}"
    note = "Scenes are paired: the mean over scenes of (row - reference), with the 95 % interval over scenes."
    return [title, note, markdown_table(header, body)]


def _claims(findings: Findings) -> list[str]:
    """One line for every two rows and metric."""
    if not findings.verdicts:
        return []
    body = [
        [
            f"{markdown_escape(one.better)} above {markdown_escape(one.worse)}",
            one.metric.title,
            estimate_text(one.advantage, one.metric, len(findings.scenes)),
            one.outcome.value,
        ]
        for one in findings.verdicts
    ]
    return ["## Claimed orderings", CLAIMS_NOTE, markdown_table(["Claim", "Metric", "Difference", "Outcome"], body)]


def _beats(findings: Findings) -> list[str]:
    """A line per scene and metric, a column per row."""
    if not findings.beats:
        return []
    reference = markdown_escape(findings.reference or "")
    cells = {(one.scene, one.metric, one.row): one for one in findings.beats}
    rows = [row for row in findings.rows if any(row == key[-1] for key in cells)]
    body = []
    for scene in findings.scenes:
        for metric in dict.fromkeys(one.metric for one in findings.beats if one.scene == scene):
            here = {row: cells[scene, metric, row] for row in rows if (scene, metric, row) in cells}
            best = metric.text(next(iter(here.values())).level)
            texts = [here[row].text if row in here else "–" for row in rows]
            body.append([markdown_escape(scene), f"{metric.group} {metric.label}", best, *texts])
    header = ["Scene", "Metric", f"Best of {reference}", *map(markdown_escape, rows)]
    return [f"## Time to beat {reference}", BEATS_NOTE.format(reference=reference), markdown_table(header, body)]


def _times(findings: Findings) -> list[str]:
    """One table per scene: a line per metric and level, a column per row."""
    if not findings.times:
        return []
    parts = ["## Time to reach an error", TIMES_NOTE]
    for scene in findings.scenes:
        cells = {(one.metric, one.level, one.row): one.text for one in findings.times if one.scene == scene}
        rows = [row for row in findings.rows if any(row == key[-1] for key in cells)]
        body = []
        for metric, level in dict.fromkeys(key[:2] for key in cells):
            sign = "≥" if metric.higher_is_better else "≤"
            texts = [cells.get((metric, level, row), "–") for row in rows]
            body.append([f"{metric.group} {metric.label} {sign} {level:g}", *texts])
        if body:
            parts.append(markdown_table([markdown_escape(scene), *map(markdown_escape, rows)], body))
    return parts


def _worsening(findings: Findings) -> str:
    """Where a metric ends below its best, largest loss first."""
    if not findings.worsening:
        return "Nowhere."
    body = []
    for one in findings.worsening:
        best = f"{one.metric.text(one.best)} at {seconds_text(one.best_seconds)} (step {one.best_step:.0f})"
        final = f"{one.metric.text(one.final)} at {seconds_text(one.final_seconds)}"
        names = [markdown_escape(one.row), markdown_escape(one.scene), f"{one.metric.group} {one.metric.label}"]
        body.append([*names, best, final, f"{one.loss_db:.2f} dB"])
    return markdown_table(["Row", "Scene", "Metric", "Best", "Final", "Lost"], body)


def _bullets(lines: Sequence[str], otherwise: str) -> str:
    return "\n".join(f"- {line}" for line in lines) or otherwise
