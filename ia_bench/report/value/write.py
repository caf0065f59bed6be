"""Write what a prior is worth: value.md, value.csv and, of what is in dB, the heat map value.{png,svg}.

photographs.csv is written where the reference was run with every number of photographs of a family.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ia_bench.common.atomic_file import whole_file
from ia_bench.report.collect import Run
from ia_bench.report.csv_text import csv_text
from ia_bench.report.figures import save
from ia_bench.report.leftovers import begins_with, remove_all_but
from ia_bench.report.statistics import CONFIDENCE
from ia_bench.report.table import Entry, Printed, carried_text
from ia_bench.report.texts import pipe_table
from ia_bench.report.value.gains import Gain, gains
from ia_bench.report.value.heat_map import DRAWN, SHOWN, draw
from ia_bench.report.value.photographs import Worth, worth
from ia_bench.runs.table import Table
from ia_bench.scores.columns import METRIC_OF

NOTHING_LEFT_OUT = "all views"
"""What a capture without a label is called."""


TITLE = "# What a prior is worth\n"
FILES = ("value.md", "value.csv", "value.png", "value.svg", "photographs.csv")


def remove_former_value(out: Path, written: Sequence[Path]) -> None:
    """Remove those FILES that a former report has left in ``out``, and that have not been ``written`` this time."""
    if begins_with(out / FILES[0], TITLE):
        remove_all_but(written, (out / name for name in FILES))


def write_value(runs: Sequence[Run], table: Table, out: Path) -> list[Path]:
    """Write the files into ``out`` and return their paths; nothing where no row has a pair of runs with the reference.

    Raises ValueError for a table without a reference.
    """
    found = gains(runs, table)
    if not found:
        return []
    photographs = worth(runs, table)
    out.mkdir(parents=True, exist_ok=True)
    texts = {
        "value.md": text(found, photographs, str(table.reference)),
        "value.csv": csv_text(map(_of_gain, found)),
    }
    if photographs:
        texts["photographs.csv"] = csv_text(map(_of_worth, photographs))
    for name, content in texts.items():
        with whole_file(out / name) as partial:
            partial.write_text(content, encoding="utf-8")
    drawn = [gain for gain in found if gain.metric.key in DRAWN]
    return [*(out / name for name in texts), *(save(draw(drawn, str(table.reference)), out / "value") if drawn else [])]


def text(found: Sequence[Gain], photographs: Sequence[Worth], reference: str) -> str:
    """The page to read."""
    judged = sum(gain.metric.key in SHOWN and gain.bootstrap is not None for gain in found)
    parts = [
        TITLE,
        f"Every row against `{reference}` of the same scene, seed and capture: mean over scenes, with the 95 % interval of the "
        "bootstrap over scenes and seeds. More is better in every column. **Bold**: decided, since neither that interval nor "
        "Student's over scenes holds zero; all else is undecided. "
        "Intervals over scenes, the smallest effect that would have been found, and what carries a mean are in value.csv. "
        f"Each cell is judged alone, without a correction for their number: of the {judged} here that have an interval, about "
        f"{(1 - CONFIDENCE) * judged:.0f} would be decided by chance, at 5 %, if no row differed from `{reference}`.\n",
        f"The column `{reference}` is its level over all of its runs of that capture: mean over scenes of the means over their "
        "seeds. A row that has fewer scenes or seeds is compared with these alone (`reference` in value.csv), so that this column "
        "plus a gain need not be that row's own level.\n",
    ]
    for key in SHOWN:
        mine = [gain for gain in found if gain.metric.key == key]
        if not mine:
            continue
        rows = list(dict.fromkeys(gain.row for gain in mine))
        captures = list(dict.fromkeys(gain.capture for gain in mine))
        cells = {(gain.row, gain.capture): gain for gain in mine}
        digits = METRIC_OF[key].digits
        body = []
        for capture in captures:
            some = [cells.get((row, capture)) for row in rows]
            level = next(gain.level for gain in some if gain is not None)
            line = [capture.label or NOTHING_LEFT_OUT, f"{level:.{digits}f}"]
            body.append([*line, *("-" if gain is None else _gain(gain, digits) for gain in some)])
        title = METRIC_OF[key].title
        parts += [f"## {title}\n", pipe_table(Printed(["capture", reference, *rows], body))]
    parts += _of_photographs(photographs, reference)
    scenes = sorted({scene for gain in found for scene in gain.pairs.pairs})
    pairs = sum(len(seeds) for seeds in found[0].pairs.pairs.values())
    parts.append(f"Scenes: {', '.join(scenes)}. Seeds differ between cells; the first cell has {pairs} pairs.\n")
    return "\n".join(parts)


def _of_photographs(photographs: Sequence[Worth], reference: str) -> list[str]:
    if not photographs:
        return []
    head = ["row", "metric", "photographs", f"photographs that {reference} needs", "95 %"]
    body = []
    for one in photographs:
        title = f"{one.metric.title} ({one.others})" if one.others else one.metric.title
        between = "-" if one.bounds is None else f"{_count(one.bounds.low)} to {_count(one.bounds.high)}"
        body.append([one.row, title, str(one.photographs), _count(one.needed), between])
    return [f"## In photographs\n\nHow many `{reference}` needs to be where a row is.\n", pipe_table(Printed(head, body))]


def _gain(gain: Gain, digits: int) -> Entry:
    drawn = gain.bootstrap
    words = f"{gain.over_scenes.mean:+.{digits}f}"
    if drawn is not None:
        words += f" ({drawn.low:+.{digits}f} to {drawn.high:+.{digits}f})"
    return Entry(words, best=bool(gain.side))


def _count(number: float) -> str:
    if math.isinf(number):
        return "more than all"
    return "fewer than the fewest" if number == 0 else f"{number:.1f}"


def _of_gain(gain: Gain) -> dict[str, Any]:
    estimate, drawn = gain.over_scenes, gain.bootstrap
    return {
        "row": gain.row,
        "capture": gain.capture.label or NOTHING_LEFT_OUT,
        "metric": gain.metric.key,
        "reference": gain.reference,
        "gain": estimate.mean,
        "low": drawn and drawn.low,
        "high": drawn and drawn.high,
        "half_width_over_scenes": estimate.half_width,
        "decided": gain.outcome,
        "detectable": gain.detectable,
        "headroom": gain.headroom,
        "scenes": len(gain.pairs.pairs),
        "pairs": sum(map(len, gain.pairs.pairs.values())),
        "carried_by": carried_text(gain.pairs),
    }


def _of_worth(one: Worth) -> dict[str, Any]:
    return {
        "row": one.row,
        "capture": one.others,
        "metric": one.metric.key,
        "photographs": one.photographs,
        "needed": one.needed,
        "low": one.bounds and one.bounds.low,
        "high": one.bounds and one.bounds.high,
        "scenes": one.scenes,
        "pairs": one.pairs,
    }
