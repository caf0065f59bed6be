"""Work-precision diagrams: error over seconds, both logarithmic, one line a case, the statistical floor dashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS: dict[str, Callable[[str], bool]] = {
    "directions (lattice points, traced)": lambda case: case in ("uniform", "cosine", "light", "BRDF", "MIS"),
    "points and shadows (MIS)": lambda case: case.startswith("MIS"),
    "beside Mitsuba 3": lambda case: case in ("MIS", "renderer", "renderer (torch, compiled)", "Mitsuba 3"),
}
INVERSE_METRICS = {"aligned_albedo_psnr": "aligned albedo, dB", "view_synthesis_psnr": "held-out views, dB"}


def forward_figure(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]) -> Figure:
    """Relative RMSE over CPU seconds of one image in three panels: directions; points and shadows; the product and Mitsuba."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for panel, (title, belongs) in zip(axes, PANELS.items(), strict=True):
        for index, case in enumerate(case for case in dict.fromkeys(row["case"] for row in rows) if belongs(case)):
            points = [row for row in rows if row["case"] == case and not row["failure"]]
            _line(panel, index, case, [row["cpu_s"] for row in points], [row["relative_rmse"] for row in points])
        panel.axhline(summary["floor"], color="0.3", linestyle="--", linewidth=1, label="floor: error of the reference")
        panel.set(title=title, xscale="log", yscale="log", xlabel="CPU seconds an image, one thread")
    axes[0].set_ylabel("relative RMSE")
    if "mitsuba_floor" in summary:
        axes[-1].axhline(summary["mitsuba_floor"], color="0.6", linestyle=":", linewidth=1, label="floor of Mitsuba's own")
    _finish(figure, f"{summary['scene']}: one view, true material and light")
    return figure


def inverse_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """PSNR over seconds of optimisation: a column for each prior, a row for each metric."""
    from matplotlib.figure import Figure

    priors = list(dict.fromkeys(row["prior"] for row in rows))
    figure = Figure(figsize=(6.2 * len(priors), 7.6), layout="constrained")
    axes = figure.subplots(len(INVERSE_METRICS), len(priors), squeeze=False)
    for column, prior in enumerate(priors):
        for panel, (metric, label) in zip(axes[:, column], INVERSE_METRICS.items(), strict=True):
            for index, case in enumerate(dict.fromkeys(row["case"] for row in rows)):
                points = [r for r in rows if (r["prior"], r["case"]) == (prior, case) and r[metric] is not None]
                _line(panel, index, case, [r["cpu_s"] for r in points], [r[metric] for r in points])
            panel.set(title=f"prior={prior}", xscale="log", xlabel="CPU seconds of optimisation, one thread", ylabel=label)
    _finish(figure, "tiny: whole fits, equal numbers of samples at each point")
    return figure


def _line(panel: Axes, index: int, case: str, seconds: list[float], values: list[float]) -> None:
    from matplotlib import color_sequences

    colour = color_sequences["petroff10"][index % 10]  # told apart by colour-blind readers too
    panel.plot(seconds, values, marker="o", markersize=4, linewidth=1.5, color=colour, label=case)


def _finish(figure: Figure, title: str) -> None:
    for panel in figure.axes:
        panel.grid(which="major", color="0.9", linewidth=0.8)
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, fontsize=8)
    figure.suptitle(title)
