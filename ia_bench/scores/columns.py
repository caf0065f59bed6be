"""The metrics as data: function, name, place in the paper's table, direction, precision. Scores, tables and figures follow it.

A new metric is a function in ``metrics.py`` and one line in :data:`METRICS`: it is then computed, recorded, tabulated and drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ia_bench.scores.metrics import Compared, lpips, psnr, root_squared_error, squared_error, ssim


@dataclass(frozen=True)
class Metric:
    """One column.

    Attributes:
        component: What is measured, as in metrics.json: "albedo", "aligned_albedo", "view_synthesis", "relighting", "roughness",
            "light" (by balls under it), "log_light".
        name: The metric's own, as in metrics.json.
        of: Two pictures of one view -> a number. Raises :class:`ia_bench.scores.metrics.Undefined` where there is none.
        group: The component as the paper prints it.
        label: The name as the paper prints it.
        higher_is_better: Whether larger values are.
        digits: Places after the point that are printed.
        on_curve: Whether it is measured during a run, for curve.csv.
    """

    component: str
    name: str
    of: Callable[[Compared], float]
    group: str
    label: str
    higher_is_better: bool
    digits: int
    on_curve: bool = False

    @property
    def key(self) -> str:
        """``component.name``, as in the reasons of metrics.json."""
        return f"{self.component}.{self.name}"

    @property
    def column(self) -> str:
        """``component_name``, as in curve.csv and in the paper's CSV."""
        return f"{self.component}_{self.name}"

    @property
    def arrow(self) -> str:
        """The arrow that points to better."""
        return "↑" if self.higher_is_better else "↓"

    @property
    def title(self) -> str:
        """Group, label and arrow, for example "Albedo PSNR ↑"."""
        return f"{self.group} {self.label} {self.arrow}"

    def text(self, value: float) -> str:
        """The value with the metric's number of digits."""
        return f"{value:.{self.digits}f}"


def _image_metrics(component: str, group: str) -> tuple[Metric, ...]:
    return (
        Metric(component, "psnr", psnr, group, "PSNR", higher_is_better=True, digits=2, on_curve=True),
        Metric(component, "ssim", ssim, group, "SSIM", higher_is_better=True, digits=4),
        Metric(component, "lpips", lpips, group, "LPIPS", higher_is_better=False, digits=4),
    )


METRICS = (
    *_image_metrics("albedo", "Albedo"),
    *_image_metrics("aligned_albedo", "Aligned albedo"),
    *_image_metrics("view_synthesis", "View synthesis"),
    *_image_metrics("relighting", "Relighting"),
    Metric("roughness", "mse", squared_error, "Roughness", "MSE", higher_is_better=False, digits=4, on_curve=True),
)
"""The columns of the paper's table."""

MEASURED = (
    *METRICS,
    Metric("light", "psnr", psnr, "Light", "PSNR", higher_is_better=True, digits=2),
    Metric("log_light", "rmse", root_squared_error, "Light", "log RMSE", higher_is_better=False, digits=3),
)
"""These, and what stands in metrics.json alone."""

COMPONENTS = tuple(dict.fromkeys(metric.component for metric in MEASURED))
CURVE_METRICS = tuple(metric for metric in METRICS if metric.on_curve)  # the columns of curve.csv
METRIC_OF = {metric.key: metric for metric in METRICS}
