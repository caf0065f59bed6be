"""Work-precision diagrams: error over seconds, both logarithmic, one line a case, the statistical floor dashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS: dict[str, Callable[[str], bool]] = {
    "directions (lattice points, traced)": lambda case: case in ("uniform", "cosine", "light", "BRDF", "MIS"),
    "points and shadows (MIS)": lambda case: case.startswith("MIS"),
    "beside Mitsuba 3": lambda case: case in ("MIS", "renderer", "renderer (torch, compiled)", "Mitsuba 3"),
}


def forward_figure(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]) -> Figure:
    """Relative RMSE over CPU seconds of one image in three panels: directions; points and shadows; the product and Mitsuba."""
    from matplotlib import color_sequences
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for panel, (title, belongs) in zip(axes, PANELS.items(), strict=True):
        for index, case in enumerate(case for case in dict.fromkeys(row["case"] for row in rows) if belongs(case)):
            points = [(row["cpu_s"], row["relative_rmse"]) for row in rows if row["case"] == case and not row["failure"]]
            colour = color_sequences["petroff10"][index % 10]  # told apart by colour-blind readers too
            panel.plot(*zip(*points, strict=True), marker="o", markersize=4, linewidth=1.5, color=colour, label=case)
        panel.axhline(summary["floor"], color="0.3", linestyle="--", linewidth=1, label="floor: error of the reference")
        panel.set(title=title, xscale="log", yscale="log", xlabel="CPU seconds an image, one thread")
        panel.grid(which="major", color="0.9", linewidth=0.8)
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("relative RMSE")
    if "mitsuba_floor" in summary:
        axes[-1].axhline(summary["mitsuba_floor"], color="0.6", linestyle=":", linewidth=1, label="floor of Mitsuba's own")
    for panel in axes:
        panel.legend(frameon=False, fontsize=8)
    figure.suptitle(f"{summary['scene']}: one view, true material and light")
    return figure
