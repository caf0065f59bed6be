"""Write what a prior is worth: value.md, value.csv and, where it is in dB, the heat map value.{png,svg}.

photographs.csv is written where the reference was run with every number of photographs of a family.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ia_bench.report.collect import Record
from ia_bench.report.curves import plain, save
from ia_bench.report.findings import Findings
from ia_bench.report.seconds import NOTHING_LEFT_OUT
from ia_bench.report.statistics import half_width
from ia_bench.report.table import Entry, Printed, carried_text, p_text
from ia_bench.report.worth import Gain, Map, maps, worth
from ia_bench.report.write import begins_with, csv_text, filled, remove_all_but, write_whole
from ia_bench.scores.metrics import METRIC_OF

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

TITLE = "# What a prior is worth\n"
FILES = ("value.md", "value.csv", "value.png", "value.svg", "photographs.csv")
COLUMN, LINE, PRINT = 0.92, 0.37, 9.25
"""Of the heat map: inches of a cell across and down, and points of its smallest print. With eight rows it is 8.3 inches wide: where
a page shows it in 800 pixels, a digit is 9 of them tall."""
LETTERS = 12  # of a line of a row's or a capture's name, if its words allow it


def write_value(findings: Findings, out: Path) -> list[Path]:
    """Write what rows of a report are worth into ``out`` and return the paths; nothing where there are no gains.

    FILES that a former report has left there go.
    """
    found = findings.gains
    shown, photographs = maps(found), worth(findings.runs, findings.table) if found else []
    texts: dict[str, str] = {}
    if found:
        reference = found[0].reference
        head = ["row", "metric", "photographs", f"photographs that {reference} needs", "95 %"]
        told: dict[str, object] = {"maps": [(one.metric.title, _printed(one)) for one in shown], "scenes": findings.scenes}
        told["photographs"] = Printed(head, [*map(_line, photographs)])
        texts["value.md"] = filled("value.md", findings, reference=reference, pairs=found[0].pairs.count, **told)
        texts["value.csv"] = csv_text(map(_of_gain, found))
    if photographs:
        texts["photographs.csv"] = csv_text(photographs)
    ours = begins_with(out / FILES[0], TITLE)
    written = [write_whole(out / name, content) for name, content in texts.items()]
    drawn = [one for one in shown if one.metric.label == "PSNR"]  # which share a scale
    written += save(_draw(drawn), out / "value") if drawn else []
    if ours:
        remove_all_but(written, (out / name for name in FILES))
    return written


def _printed(one: Map) -> Printed:
    body = [[label, one.metric.text(level), *map(_entry, some)] for label, level, some in one.lines]
    return Printed(["capture", one.reference, *one.rows], body)


def _entry(gain: Gain | None) -> Entry | str:
    if gain is None:
        return "-"
    signs = [] if gain.pairs.signs is None else ["{}/{} p {}".format(*gain.pairs.signs[:2], p_text(gain.pairs.signs[2]))]
    some = [f"{len(gain.pairs.pairs)}/{gain.scenes} scenes"] if not gain.complete else []
    behind = "; ".join(filter(None, [gain.between, *signs, *some]))
    return Entry(f"{gain.text}{' °' if gain.alone else ''}{behind and f' ({behind})'}", best=gain.survives)


def _line(one: Record) -> list[str]:
    def count(number: float) -> str:
        return "more than all" if math.isinf(number) else "fewer than the fewest" if number == 0 else f"{number:.1f}"

    title, others = METRIC_OF[one["metric"]].title, f" ({one['capture']})" if one["capture"] else ""
    between = "-" if one["low"] is None else f"{count(one['low'])} to {count(one['high'])}"
    return [one["row"], f"{title}{others}", str(one["photographs"]), count(one["needed"]), between]


def _of_gain(gain: Gain) -> Record:
    low, high = gain.bootstrap or (None, None)
    return {
        "row": gain.row,
        "capture": gain.capture or NOTHING_LEFT_OUT,
        "metric": gain.metric.key,
        "reference": gain.beside,
        "gain": gain.mean,
        "low": low,
        "high": high,
        "half_width_over_scenes": half_width(gain.pairs.scenes),
        "half_width_new_scene": gain.pairs.new_scene,
        "p_value": gain.p_value,
        "scenes_above": gain.pairs.signs and gain.pairs.signs[0],
        "sign_test_p_value": gain.pairs.signs and gain.pairs.signs[2],
        "decided": f"{gain.outcome}{', decided alone' if gain.alone else ''}",
        "detectable": gain.detectable,
        "scenes": len(gain.pairs.pairs),
        "pairs": gain.pairs.count,
        "carried_by": carried_text(gain.pairs),
    }


def _draw(shown: Sequence[Map]) -> Figure:
    """A panel for every metric in dB, one below the other: captures by rows, with the gain as colour and number, and its interval.

    What is undecided is hatched.
    """
    from matplotlib.figure import Figure

    lines, rows = [len(one.lines) for one in shown], max(len(one.rows) for one in shown)
    largest = max(one.largest for one in shown) or 1.0
    size = 0.9 + COLUMN * max(rows, 4), 0.9 + 0.9 * len(lines) + LINE * sum(lines)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(shown), 1, squeeze=False, height_ratios=lines)[:, 0]
    for panel, one in zip(panels, shown, strict=True):
        image = _draw_panel(panel, one, largest)
    over = "no prior" if shown[0].reference == "none" else plain(shown[0].reference)
    bar = figure.colorbar(image, ax=panels, location="bottom", aspect=40, pad=0.01)
    bar.set_label(f"dB gained over {over}; hatched: undecided", fontsize=PRINT + 1)
    bar.ax.tick_params(labelsize=PRINT)
    return figure


def _draw_panel(panel: Axes, one: Map, largest: float) -> AxesImage:
    from matplotlib.patches import Rectangle

    cells = {(x, y): gain for y, (*_, some) in enumerate(one.lines) for x, gain in enumerate(some) if gain is not None}
    values = np.full((len(one.lines), len(one.rows)), np.nan)
    for (x, y), gain in cells.items():
        values[y, x] = gain.mean
        if gain.outcome == "undecided":
            box = Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, hatch="/", edgecolor="0.75", linewidth=0)
            panel.add_patch(box)
        style: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 2}  # above the hatching
        style["color"] = "white" if abs(values[y, x]) > 0.6 * largest else "black"
        panel.text(x, y - 0.2, gain.text, fontsize=PRINT + 1, **style)
        panel.text(x, y + 0.24, gain.between.replace("+", ""), fontsize=PRINT, **style)
    panel.set_title(one.metric.group, fontsize=PRINT + 2)
    panel.xaxis.tick_top()
    for axis, names in ((panel.xaxis, one.rows), (panel.yaxis, [label for label, *_ in one.lines])):
        axis.set_ticks(range(len(names)), [plain(textwrap.fill(name, LETTERS)) for name in names], fontsize=PRINT)
    return panel.imshow(values, cmap="PuOr", vmin=-largest, vmax=largest, aspect="auto")
