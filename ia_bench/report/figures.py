"""One figure per scene: every metric over seconds of optimisation, all rows, seeds as bands, the ceiling dashed.

matplotlib is imported when a figure is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ia_bench.common.atomic_file import whole_file
from ia_bench.report.collect import Runs
from ia_bench.report.curve import Curve
from ia_bench.scores.columns import CURVE_METRICS, Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

DASHES = ("-", (0, (5, 1.5)), (0, (5, 1, 1, 1)))  # in turn, so that rows of like colours differ; with ten colours, 30 rows


def draw_scene(runs: Runs, scene: str, rows: Sequence[str]) -> Figure | None:
    """Draw the curves of one scene; None where no run of it has a curve.

    A row keeps its colour in every scene, by its place in ``rows``. A line is the mean of its seeds, its band reaches
    from the lowest to the highest of them. The time axis is logarithmic, so points at 0 seconds are not shown.
    """
    here = runs[(runs["scene"] == scene) & runs["curve"].notna()]
    curves = {row: list(here.loc[here["row"] == row, "curve"]) for row in rows}
    if not any(curves.values()):
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 7.2), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for panel, metric in zip(axes, CURVE_METRICS, strict=False):
        _draw_metric(panel, metric, curves)
    handles = {text: handle for panel in axes for handle, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    ordered = [plain(row) for row in rows if plain(row) in handles]
    axes[-1].axis("off")
    axes[-1].legend([handles[row] for row in ordered], ordered, loc="center left", frameon=False, fontsize=11)
    figure.suptitle(f"{plain(scene)}: quality against run time, scored on a subset of the views (time of scoring not counted)")
    return figure


def plain(name: str) -> str:
    """A name as matplotlib draws it letter by letter: between two dollar signs it would be typeset as mathematics."""
    return name.replace("$", r"\$")


def save(figure: Figure, path: Path) -> list[Path]:
    """Write PNG and SVG beside each other (``path`` without its ending); the same figure gives the same bytes."""
    import matplotlib

    files = [path.with_name(f"{path.name}.{kind}") for kind in ("png", "svg")]
    with matplotlib.rc_context({"svg.hashsalt": "ia_bench"}):
        with whole_file(files[0]) as partial:
            figure.savefig(partial, dpi=130)
        with whole_file(files[1]) as partial:
            figure.savefig(partial, metadata={"Date": None})
    return files


def _draw_metric(panel: Axes, metric: Metric, curves: dict[str, list[Curve]]) -> None:
    from matplotlib import color_sequences

    colours = color_sequences["petroff10"]  # told apart by colour-blind readers too
    for index, (row, found) in enumerate(curves.items()):
        measured = [(curve.is_level, *curve.measured(metric.column)) for curve in found]
        levels = [values[-1] for is_level, _, _, values in measured if is_level and len(values)]
        optimised = [(seconds, values) for is_level, _, seconds, values in measured if not is_level]
        points = [(seconds[seconds > 0], values[seconds > 0]) for seconds, values in optimised if (seconds > 0).any()]
        style = {"color": colours[index % 10], "linestyle": DASHES[index % len(DASHES)], "label": plain(row)}
        if points:
            _draw_seeds(panel, points, style)
        if levels:
            panel.axhline(float(np.mean(levels)), color="0.25", linestyle="--", linewidth=1.2, label=plain(row))
    panel.set_xscale("log")
    _label_plainly(panel.xaxis)
    panel.set_title(metric.title, fontsize=11)
    panel.set_xlabel("seconds of optimisation")
    panel.set_ylabel("dB" if metric.name == "psnr" else "squared error")
    if metric.name == "mse":
        panel.set_yscale("log")
        _label_plainly(panel.yaxis)
    panel.grid(which="major", color="0.9", linewidth=0.8)
    panel.spines[["top", "right"]].set_visible(False)
    if not panel.has_data():
        panel.text(0.5, 0.5, "not measured", transform=panel.transAxes, ha="center", color="0.5")


def _label_plainly(axis: Axis) -> None:
    """Label a logarithmic axis 1, 2, 5, 10, ... instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _draw_seeds(panel: Axes, points: list[tuple[np.ndarray, np.ndarray]], style: dict) -> None:
    """Draw one row: the mean of its seeds at common times, and their range.

    Seeds without a span of time in common, one alone or some that were scored once, are drawn as they were measured.
    """
    first, last = max(seconds[0] for seconds, _ in points), min(seconds[-1] for seconds, _ in points)
    if len(points) == 1 or last <= first:
        for seconds, seen in points:
            panel.plot(seconds, seen, marker="o", markersize=3, linewidth=1.5, **style)
        return
    times = np.geomspace(first, last, 64)
    values = np.array([np.interp(np.log(times), np.log(seconds), seen) for seconds, seen in points])
    panel.plot(times, values.mean(axis=0), linewidth=1.5, **style)
    panel.fill_between(times, values.min(axis=0), values.max(axis=0), color=style["color"], alpha=0.2, linewidth=0)
