"""The map of gains: photographs by what else a capture leaves out, a panel for every row and metric.

matplotlib is imported when the map is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ia_bench.report.value.gains import Gain, in_words
from ia_bench.scores.columns import METRIC_OF

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

SHOWN = ("aligned_albedo.psnr", "relighting.psnr", "roughness.mse")
DRAWN = SHOWN[:2]  # in dB both, so that they share a scale


def draw(found: Sequence[Gain], reference: str) -> Figure:
    """Colour is the mean gain in dB, the same scale in all panels; below it its interval. What is not decided is hatched.

    Args:
        found: At least one gain, in the metrics DRAWN.
        reference: The row over which they are gained.
    """
    from matplotlib.figure import Figure

    rows = list(dict.fromkeys(gain.row for gain in found))
    others = {row: list(dict.fromkeys(gain.capture.others for gain in found if gain.row == row)) for row in rows}
    counts = sorted({gain.photographs for gain in found})
    largest = max(abs(gain.over_scenes.mean) for gain in found) or 1.0
    widths, height = [max(1.6, 0.95 * len(kinds)) for kinds in others.values()], 0.45 * len(counts)  # of panels
    figure = Figure(figsize=(1.6 + 0.2 * len(rows) + sum(widths), 2.4 + height * len(DRAWN)), layout="constrained")
    panels = figure.subplots(len(DRAWN), len(rows), squeeze=False, width_ratios=widths)
    for line, key in zip(panels, DRAWN, strict=True):
        for panel, row in zip(line, rows, strict=True):
            cells = {
                (counts.index(gain.photographs), others[row].index(gain.capture.others)): gain
                for gain in found
                if (gain.row, gain.metric.key) == (row, key)
            }
            image = _draw_panel(panel, cells, (len(counts), len(others[row])), largest)
            panel.set_title(f"{row}\n{METRIC_OF[key].group}", fontsize=9)
            panel.set_xticks(range(len(others[row])), [in_words(other) for other in others[row]], fontsize=8)
            panel.set_yticks(range(len(counts)), [str(count) for count in counts], fontsize=8)
    for line in panels:
        line[0].set_ylabel("photographs", fontsize=9)
    over = "no prior" if reference == "none" else reference
    figure.colorbar(image, ax=panels, label=f"dB gained over {over}; hatched: undecided", shrink=0.8)
    return figure


def _draw_panel(panel: Axes, cells: dict[tuple[int, int], Gain], size: tuple[int, int], largest: float) -> AxesImage:
    from matplotlib.patches import Rectangle

    values = np.full(size, np.nan)
    for place, gain in cells.items():
        values[place] = gain.over_scenes.mean
    image = panel.imshow(values, cmap="PuOr", vmin=-largest, vmax=largest, aspect="auto")
    for (y, x), gain in cells.items():
        if not gain.side:
            box = Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, hatch="///", edgecolor="0.75", linewidth=0)
            panel.add_patch(box)
        color = "white" if abs(gain.over_scenes.mean) > 0.6 * largest else "black"
        words = partial(panel.text, ha="center", va="center", color=color, zorder=2)  # above the hatching
        words(x, y - 0.16, f"{gain.over_scenes.mean:+.2f}", fontsize=9)
        drawn = gain.bootstrap
        if drawn is not None:
            words(x, y + 0.24, f"{drawn.low:+.2f} to {drawn.high:+.2f}", fontsize=6.5)
    return image
