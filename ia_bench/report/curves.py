"""Error against run time: the curve.csv of a run, one figure per scene with every metric over seconds, and score against seconds.

matplotlib is imported when a figure is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.scores.metrics import CURVE_METRICS, METRIC_OF, Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

DASHES = ("-", (0, (5, 1.5)), (0, (5, 1, 1, 1)))  # in turn, so that rows of like colours differ; with ten colours, 30 rows
CAPTURES = 4  # that a picture shows at most
LEADER = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 4}
"""A thin line from a point to a name that does not stand beside it."""
PLACES = tuple(
    ((side * 7, up), "left" if side > 0 else "right") for up in (0, 9, -9, 18, -18, 27, -27, 36, -36) for side in (1, -1)
)
"""Where a point's name may stand: offsets in points, the first ones first."""
POINT = 5  # pixels around a point, and around a name, that no other name should hide


@dataclass(frozen=True)
class Curve:
    """Error against run time: steps and seconds without scoring, (N,); column of curve.csv -> values (N,), NaN if not measured."""

    steps: np.ndarray
    seconds: np.ndarray
    values: dict[str, np.ndarray]

    @property
    def is_level(self) -> bool:
        """Whether nothing was optimised, as of the bounds: a level, not a curve."""
        return not (self.steps.any() and self.seconds.any())

    def measured(self, column: str) -> tuple[np.ndarray, np.ndarray]:
        """Seconds and values of one column where it has a finite value."""
        there = np.isfinite(self.values[column])
        return self.seconds[there], self.values[column][there]


def read_curve(path: Path) -> Curve | None:
    """Read a curve.csv; None where there is none. Raises InputError naming file and line."""
    if not path.is_file():
        return None
    try:
        texts = pd.read_csv(path, dtype=str)
    except (OSError, ValueError) as error:  # of pandas, its own errors are among them
        raise InputError(f"{path}: expected a CSV file, found: {error}") from error
    missing = next((name for name in ("step", "seconds") if name not in texts), None)
    if missing is not None:
        raise InputError(f"{path}: expected a column {missing}, found {', '.join(texts.columns)}")
    columns = [metric.column for metric in CURVE_METRICS]
    numbers = texts.reindex(columns=["step", "seconds", *columns]).apply(pd.to_numeric, errors="coerce").astype(float)
    for name in numbers:
        wrong = texts.index[numbers[name].isna() & texts[name].notna()] if name in texts else []
        if len(wrong):  # line 1 is the header
            raise InputError(f"{path}, line {wrong[0] + 2}, {name}: expected a number, found {texts[name][wrong[0]]!r}")
    steps, seconds = numbers["step"].to_numpy(), numbers["seconds"].to_numpy()
    if not (np.isfinite(steps).all() and np.isfinite(seconds).all() and (np.diff(seconds) >= 0).all()):
        raise InputError(f"{path}: expected a step and rising seconds in every line")
    return Curve(steps.astype(int), seconds, {name: numbers[name].to_numpy() for name in columns}) if len(texts) else None


def draw_scene(runs: pd.DataFrame, scene: str, rows: Sequence[str]) -> Figure | None:
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
    handles = {line.get_label(): line for panel in axes for line in panel.get_lines()}  # legends leave out those that begin with _
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
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": "ia_bench"}):
        with whole_file(files[0]) as partial:
            figure.savefig(partial, dpi=130)
        with whole_file(files[1]) as partial:
            figure.savefig(partial, metadata={"Date": None})
    return files


def _finish(panel: Axes, axes: Sequence[Axis], subs: Sequence[float]) -> None:
    """Write round numbers (``subs`` times powers of ten) on logarithmic axes, and no powers of ten; draw a grid without a frame."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for axis in axes:
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())
    panel.grid(which="major", color="0.9", linewidth=0.8)
    panel.spines[["top", "right"]].set_visible(False)


def _colour(place: int) -> Any:  # noqa: ANN401 (as matplotlib has it)
    """The colour of the row at that ``place``, of ten that colour-blind readers tell apart, too."""
    from matplotlib import color_sequences

    return color_sequences["petroff10"][place % 10]


def _draw_metric(panel: Axes, metric: Metric, curves: dict[str, list[Curve]]) -> None:
    for index, (row, found) in enumerate(curves.items()):
        levels = [values[-1] for curve in found if curve.is_level and len(values := curve.measured(metric.column)[1])]
        measured = [curve.measured(metric.column) for curve in found if not curve.is_level]
        points = [(seconds[seconds > 0], values[seconds > 0]) for seconds, values in measured if (seconds > 0).any()]
        style = {"color": _colour(index), "linestyle": DASHES[index % len(DASHES)], "label": plain(row)}
        if points:
            _draw_seeds(panel, points, style)
        if levels:
            panel.axhline(float(np.mean(levels)), color="0.25", linestyle="--", linewidth=1.2, label=plain(row))
    panel.set(xscale="log", yscale="log" if metric.name == "mse" else "linear", xlabel="seconds of optimisation")
    panel.set_ylabel("dB" if metric.name == "psnr" else "squared error")
    panel.set_title(metric.title, fontsize=11)
    _finish(panel, (panel.xaxis, panel.yaxis) if metric.name == "mse" else (panel.xaxis,), (1, 2, 5))
    if not panel.has_data():
        panel.text(0.5, 0.5, "not measured", transform=panel.transAxes, ha="center", color="0.5")


def _draw_seeds(panel: Axes, points: list[tuple[np.ndarray, np.ndarray]], style: dict) -> None:
    """Draw one row: mean and range of its seeds at common times; those without a span of time in common as they were measured."""
    first, last = max(seconds[0] for seconds, _ in points), min(seconds[-1] for seconds, _ in points)
    if len(points) == 1 or last <= first:
        for seconds, seen in points:
            panel.plot(seconds, seen, marker="o", markersize=3, linewidth=1.5, **style)
        return
    times = np.geomspace(first, last, 64)
    values = np.array([np.interp(np.log(times), np.log(seconds), seen) for seconds, seen in points])
    panel.plot(times, values.mean(axis=0), linewidth=1.5, **style)
    panel.fill_between(times, values.min(axis=0), values.max(axis=0), color=style["color"], alpha=0.2, linewidth=0)


# ---- which rows nobody beats in less time ----


def draw_pareto(found: list[dict[str, Any]], rows: Sequence[str]) -> Figure | None:
    """A panel for every capture and metric of :func:`ia_bench.report.seconds.points`; None where no row has a score.

    A row has the colour that its curves have (:func:`draw_scene`), by its place in ``rows``; of several captures it has one in all.
    """
    keys = [METRIC_OF[key] for key in dict.fromkeys(key for one in found for row in one["rows"] for key in row["scores"])]
    if not keys:
        return None
    from matplotlib.figure import Figure

    shown, every = found[:CAPTURES], [row for one in found for row in one["rows"]]
    named = list(dict.fromkeys(row["name"] for name in rows for row in every if row["row"] == name))
    place = {row["row"]: rows.index(row["row"]) if len(found) == 1 else named.index(row["name"]) for row in every}
    figure = Figure(figsize=(6.2 * len(keys), 4.2 * len(shown)), layout="constrained")
    panels = figure.subplots(len(shown), len(keys), squeeze=False)
    drawn = [
        (panel, metric, one) for line, one in zip(panels, shown, strict=True) for panel, metric in zip(line, keys, strict=True)
    ]
    for panel, metric, one in drawn:
        _draw_front(panel, metric, one, place)
    figure.draw_without_rendering()  # after which panels stay where they are
    for panel, metric, one in drawn:
        scored = [row for row in one["rows"] if metric.key in row["scores"]]
        _name_points(panel, {plain(row["name"]): (row["cost"], row["scores"][metric.key]) for row in scored})
    return figure


def _name_points(panel: Axes, points: dict[str, tuple[float, float]]) -> None:
    """Write the name of every point beside it: at the first of PLACES that is free, or where it hides least."""
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    pixels = panel.transData.transform(list(points.values()))
    taken = [Bbox.from_extents(*(at - POINT), *(at + POINT)) for at in pixels]
    if (legend := panel.get_legend()) is not None:
        taken.append(legend.get_window_extent())
    inside = panel.get_window_extent()
    for name, at in sorted(points.items(), key=lambda item: -item[1][1]):
        text = panel.annotate(name, at, xytext=(0, 0), textcoords="offset points", fontsize=7.5, color="0.25", in_layout=False)
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])  # over the lines
        hidden = []
        for offset, side in PLACES:
            text.set(position=offset, ha=side, va="center")
            box = text.get_window_extent()
            parts = [part for other in taken if (part := Bbox.intersection(box, other)) is not None]
            within = Bbox.intersection(box, inside)
            outside = box.width * box.height - (0 if within is None else within.width * within.height)
            hidden.append((sum(part.width * part.height for part in parts) + outside, offset, side))
            if not hidden[-1][0]:
                break
        _, offset, side = min(hidden)
        text.set(position=offset, ha=side)
        if offset[1]:
            panel.annotate("", at, xytext=offset, textcoords="offset points", arrowprops=LEADER, in_layout=False)
        taken.append(text.get_window_extent().padded(POINT))


def _draw_front(panel: Axes, metric: Metric, one: dict[str, Any], place: dict[str, int]) -> None:
    from matplotlib.ticker import LogLocator

    rows = [row for row in one["rows"] if metric.key in row["scores"]]
    front = [row for row in rows if metric.key in row["front"]]
    curve: list[dict[str, Any]] = []
    for row in rows:
        if row["curve"] and (not curve or row["scores"][metric.key] > curve[-1]["scores"][metric.key]):
            curve.append(row)
    lines = {"Pareto front": front, f"{plain(one['reference'])} with more work": curve}
    looks: list[dict[str, Any]] = [{"drawstyle": "steps-post", "color": "0.6"}, {"color": "0.2", "linestyle": "--"}]
    for (label, some), look in zip(lines.items(), looks, strict=True):
        if len(some) > 1:
            scores = [row["scores"][metric.key] for row in some]
            panel.plot([row["cost"] for row in some], scores, label=label, linewidth=1.2, **look)
    for row in rows:
        look = {"color": _colour(place[row["row"]]), "fillstyle": "full" if row in front else "none", "markersize": 6, "zorder": 3}
        panel.plot(row["cost"], row["scores"][metric.key], "o", **look)
    panel.set(xscale="log", xlabel=f"seconds of a fit, times those of {plain(one['reference'])}", ylabel="dB")
    named = [f"{metric.group} {metric.label}", *([plain(one["capture"])] if one["capture"] else [])]
    panel.set_title(", ".join(named), fontsize=10)
    panel.margins(x=0.18, y=0.12)
    if len(front) > 1 or len(curve) > 1:
        panel.legend(fontsize=8, frameon=False, loc="best")
    _finish(panel, (panel.xaxis,), (1, 1.5, 2, 3, 5, 7))
    low, high = panel.get_xlim()
    if len([at for at in LogLocator(subs=(1, 1.5, 2, 3, 5, 7)).tick_values(low, high) if low <= at <= high]) < 2:  # rows cost alike
        panel.set_xscale("linear")
