"""The numbers of one run: means, values per image, and a reason for everything that is no number.

A value per image is a float or the :class:`~ia_bench.scores.metrics.Undefined` that explains its absence. The mean exists only
where every image has a value: a mean over the images that happened to work would reward failing on the hard ones. Views without
a scored pixel, which are the same for every method, are left out. An infinite PSNR (identical images) makes the mean infinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ia_bench.scores.columns import COMPONENTS, Metric
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined
from ia_bench.scores.predictions import Pair
from ia_bench.scores.protocol import Protocol

REDRAWN = "_reference"
"""How the names of scores end that are of exported textures, drawn by the reference renderer beside a method's own pictures."""

Value = float | Undefined
Views = list[Pair] | dict[str, list[Pair]] | str  # of one component (per light for relighting), or why there are none


@dataclass(frozen=True)
class Scores:
    """Numbers of one run, each a number, +inf (PSNR of identical images) or None, with the reason of every non-number.

    Attributes:
        protocol: What they are computed under.
        renderer: The name of what drew the pictures.
        metrics: Component -> metric -> mean.
        variants: The same under other definitions, each named.
        per_image: Component (-> light) -> metric -> one value per view.
        reasons: Dotted path -> why it is null in JSON.
        counts: Component -> numbers of views, pixels, clipped values; "textures" -> texels, and those drawn rougher than they are.
        albedo_scales: Alignment -> RGB scale, None where there is none.
        geometry: The recovered shape against the true one, empty where it was given.
    """

    protocol: Protocol
    renderer: str = ""
    metrics: dict[str, dict[str, float | None]] = field(default_factory=dict)
    variants: dict[str, dict[str, float | None]] = field(default_factory=dict)
    per_image: dict[str, Any] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    albedo_scales: dict[str, list[float] | None] = field(default_factory=dict)
    geometry: dict[str, Any] = field(default_factory=dict)

    def record(self, component: str, views: Views, compare: Callable[[Pair], Compared], metrics: Sequence[Metric]) -> None:
        """Measure every view of a component; store means, values per image, reasons and counts."""
        means = self.metrics if component in COMPONENTS else self.variants
        if isinstance(views, str):
            means[component] = dict.fromkeys(metric.name for metric in metrics)
            self.reasons.update({f"{component}.{metric.name}": views for metric in metrics})
            return

        groups = views if isinstance(views, dict) else {"": views}
        measured = {light: [_measured(view, compare, metrics) for view in group] for light, group in groups.items()}
        means[component] = {}
        for name in (metric.name for metric in metrics):
            values = {light: [found[name] for found, _ in group] for light, group in measured.items()}
            mean = mean_over_images([value for group in values.values() for value in group])
            means[component][name] = mean
            why = {light: reason for light, group in values.items() if (reason := explain(group))}
            if mean is None or math.isinf(mean):
                text = "; ".join(f"{light}: {reason}" if light else reason for light, reason in why.items())
                self.reasons[f"{component}.{name}"] = text or "no image"
            for light, reason in why.items():
                self.reasons[".".join(filter(None, ("per_image", component, light, name)))] = reason

        by_light = {
            light: {metric.name: [found[metric.name] for found, _ in group] for metric in metrics}
            for light, group in measured.items()
        }
        self.per_image[component] = by_light.get("", by_light)
        pairs = [view for group in groups.values() for view in group]
        everything = [one for group in measured.values() for one in group]
        self.counts[component] = {
            "views": len(pairs),
            "views_without_scored_pixel": sum(
                all(isinstance(value, NoScoredPixel) for value in found.values()) for found, _ in everything
            ),
            "scored_pixels": sum(int(view.mask.sum()) for view in pairs),
            "uncovered_pixels": sum(int((view.mask & (view.coverage[0] == 0)).sum()) for view in pairs),
            "clipped_prediction": sum(clipped[0] for _, clipped in everything),
            "clipped_truth": sum(clipped[1] for _, clipped in everything),
        }

    def as_dict(self) -> dict[str, Any]:
        """Return what metrics.json stores; what is no finite number becomes null, its reason stands in ``reasons``."""
        return {
            "protocol": self.protocol.label,
            "protocol_description": self.protocol.describe(),
            "renderer": self.renderer,
            "metrics": finite_or_none(self.metrics),
            "variants": finite_or_none(self.variants),
            "per_image": finite_or_none(self.per_image),
            "reasons": dict(self.reasons),
            "counts": {component: dict(counts) for component, counts in self.counts.items()},
            "albedo_scales": dict(self.albedo_scales),
            "geometry": dict(self.geometry),
        }


def drawn_scale(scales: Mapping[str, list[float] | None], alignment: str) -> list[float] | None:
    """The RGB scale (3,) of the textures that pictures show: their own where they were exported, else that of the method's maps.

    Args:
        scales: ``albedo_scales`` of the scores.
        alignment: The protocol's.

    Returns:
        None where there is neither: the albedo could not be aligned.
    """
    return scales.get(alignment + REDRAWN) or scales.get(alignment)


def mean_over_images(values: Sequence[Value]) -> float | None:
    """Arithmetic mean over the images with scored pixels; None where there is no such image or one has no value."""
    scored = [value for value in values if not isinstance(value, NoScoredPixel)]
    numbers = [value for value in scored if not isinstance(value, Undefined)]
    return math.fsum(numbers) / len(numbers) if numbers and len(numbers) == len(scored) else None


def explain(values: Sequence[Value]) -> str | None:
    """Why some of the values are null in JSON, grouped by reason; None where all are finite numbers.

    >>> explain([20.0, float("inf")])
    'identical (image 1)'
    """
    if not values:
        return "no image"
    where: dict[str, list[int]] = {}
    for index, value in enumerate(values):
        if isinstance(value, Undefined):
            where.setdefault(str(value), []).append(index)
        elif math.isinf(value):
            where.setdefault("identical", []).append(index)
    return "; ".join(f"{reason} ({_named(found, len(values))})" for reason, found in where.items()) or None


def finite_or_none(tree: object) -> object:
    """Copy nested dicts and lists, with None for every Undefined and every infinity (JSON has neither)."""
    if isinstance(tree, Mapping):
        return {key: finite_or_none(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [finite_or_none(value) for value in tree]
    if isinstance(tree, Undefined) or (isinstance(tree, float) and math.isinf(tree)):
        return None
    return tree


def _measured(
    view: Pair, compare: Callable[[Pair], Compared], metrics: Sequence[Metric]
) -> tuple[dict[str, Value], tuple[int, int]]:
    """The value of every metric by its name, or why there is none; and how many values were clipped in prediction and truth."""
    try:
        compared = compare(view)
    except Undefined as reason:
        return dict.fromkeys((metric.name for metric in metrics), reason), (0, 0)
    values: dict[str, Value] = {}
    for metric in metrics:
        try:
            values[metric.name] = metric.of(compared)
        except Undefined as reason:
            values[metric.name] = reason
    return values, compared.clipped


def _named(indices: list[int], total: int) -> str:
    if len(indices) == total:
        return "every image"
    return f"image{'s' if len(indices) > 1 else ''} {', '.join(map(str, indices))}"
