"""The metrics as data: name, place in the paper's table, direction, precision. Tables, arrows and figures follow it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """One column: ``component`` and ``name`` as in metrics.json; ``group`` and ``label`` as the paper prints them."""

    component: str
    name: str
    group: str
    label: str
    higher_is_better: bool
    digits: int

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
        Metric(component, "psnr", group, "PSNR", higher_is_better=True, digits=2),
        Metric(component, "ssim", group, "SSIM", higher_is_better=True, digits=4),
        Metric(component, "lpips", group, "LPIPS", higher_is_better=False, digits=4),
    )


METRICS = (
    *_image_metrics("albedo", "Albedo"),
    *_image_metrics("aligned_albedo", "Aligned albedo"),
    *_image_metrics("view_synthesis", "View synthesis"),
    *_image_metrics("relighting", "Relighting"),
    Metric("roughness", "mse", "Roughness", "MSE", higher_is_better=False, digits=4),
)

CURVE_METRICS = tuple(metric for metric in METRICS if metric.name in ("psnr", "mse"))  # the columns of curve.csv
METRIC_OF = {metric.key: metric for metric in METRICS}
