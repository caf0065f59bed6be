"""Score against seconds: the picture of which rows nobody beats in less time. matplotlib is imported when it is drawn."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ia_bench.report.collect import Record, Runs
from ia_bench.report.curves import plain
from ia_bench.report.seconds import WORTH_METRICS, Timing, compared
from ia_bench.scores.metrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CAPTURES = 4  # that a picture shows at most
PLACES = (((6, -9), "left"), ((6, 4), "left"), ((-6, 4), "right"), ((-6, -9), "right"))
"""Where a point's name may stand: beside other names the next place is taken."""
NEAR = (0.3, 0.04)  # shares of what costs (their logarithms) and scores span within which names would meet


def points(runs: Runs, time: Timing) -> list[Record]:
    """What is drawn, as JSON types: for every capture its ``rows``, the cheapest first, each with its cost and scores by metric.

    ``front``: metrics in which a row is on the front; ``curve``: whether it is the reference, or that with more work. Captures
    under which the reference has no curve are left out, if others have one.
    """
    tables = {metric.key: compared(runs, time, metric) for metric in WORTH_METRICS}
    found = []
    for clock in [one for one in time.clocks if len(one.curve) > 1] or time.clocks[:1]:
        rows = [
            {
                "row": row,
                "name": clock.short(row),
                "cost": round(clock.costs[row], 4),
                "scores": {key: round(score, 4) for key, rows in tables.items() if (score := rows[row].score) is not None},
                "front": [key for key, rows in tables.items() if rows[row].front],
                "curve": row in clock.curve,
            }
            for row in sorted(clock.costs, key=clock.costs.__getitem__)
        ]
        rows = [row for row in rows if row["scores"]]
        found += [{"capture": clock.capture, "reference": clock.short(clock.reference), "rows": rows}] if rows else []
    return found


def draw_pareto(found: list[Record]) -> Figure | None:
    """A panel for every capture of ``points`` and metric; None where no row has a score."""
    keys = [metric for metric in WORTH_METRICS if any(metric.key in row["scores"] for one in found for row in one["rows"])]
    if not keys:
        return None
    from matplotlib.figure import Figure

    shown = found[:CAPTURES]
    figure = Figure(figsize=(6.2 * len(keys), 4.2 * len(shown)), layout="constrained")
    for line, one in zip(figure.subplots(len(shown), len(keys), squeeze=False), shown, strict=True):
        for panel, metric in zip(line, keys, strict=True):
            _draw_panel(panel, metric, one)
    return figure


def _draw_panel(panel: Axes, metric: Metric, one: Record) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    rows = [row for row in one["rows"] if metric.key in row["scores"]]
    front = [row for row in rows if metric.key in row["front"]]
    curve: list[Record] = []
    for row in rows:
        if row["curve"] and (not curve or row["scores"][metric.key] > curve[-1]["scores"][metric.key]):
            curve.append(row)
    lines = {"Pareto front": front, f"{plain(one['reference'])} with more work": curve}
    looks: list[dict[str, Any]] = [{"drawstyle": "steps-post", "color": "0.3"}, {"color": "C1", "linestyle": "--"}]
    for (label, some), look in zip(lines.items(), looks, strict=True):
        scores = [row["scores"][metric.key] for row in some]
        panel.plot([row["cost"] for row in some], scores, label=label, linewidth=1.2, **look)
    ends = np.array([(math.log(row["cost"]), row["scores"][metric.key]) for row in rows])
    near = NEAR * np.maximum(np.ptp(ends, axis=0), 1e-9)
    for place, row in enumerate(rows):
        at, fill = (row["cost"], row["scores"][metric.key]), "full" if row in front else "none"
        look = {"color": "C1" if row["curve"] else "C0", "fillstyle": fill, "markersize": 6, "zorder": 3}
        panel.plot(*at, "o", **look)
        others = (np.abs(ends[:place] - ends[place]) <= near).all(axis=1).sum()
        offset, side = PLACES[others % len(PLACES)]
        panel.annotate(plain(row["name"]), at, xytext=offset, ha=side, textcoords="offset points", fontsize=7.5, color="0.25")
    panel.set(xscale="log", xlabel=f"seconds of a fit, times those of {plain(one['reference'])}", ylabel="dB")
    named = [f"{metric.group} {metric.label}", *([plain(one["capture"])] if one["capture"] else [])]
    panel.set_title(", ".join(named), fontsize=10)
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.margins(x=0.18, y=0.12)
    panel.legend(fontsize=8, frameon=False, loc="best")
    panel.grid(which="major", color="0.9", linewidth=0.8)
    panel.spines[["top", "right"]].set_visible(False)
