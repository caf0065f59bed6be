"""The numbers of one run: means, values per image, and a reason for everything that is no number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ia_bench.scores.components import Measure, Measured
from ia_bench.scores.metrics import NoScoredPixel
from ia_bench.scores.predictions import Pair
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.reduction import explain, finite_or_none, mean_over_images

COMPONENTS = ("albedo", "aligned_albedo", "view_synthesis", "relighting", "roughness")

REDRAWN = "_reference"
"""How the names of scores end that are of exported textures, drawn by the reference renderer beside a method's own pictures."""

Views = list[Pair] | dict[str, list[Pair]] | str  # of one component (per light for relighting), or why there are none


@dataclass(frozen=True)
class Scores:
    """Numbers of one run, each a number, +inf (PSNR of identical images) or None, with the reason of every non-number.

    ``metrics``: component -> metric -> mean. ``variants``: the same under other definitions, each named. ``per_image``:
    component (-> light) -> metric -> one value per view. ``reasons``: dotted path -> why it is null in JSON.
    ``counts``: component -> numbers of views, pixels, clipped values. ``albedo_scales``: alignment -> RGB scale.
    ``renderer``: the name of what drew the pictures. ``geometry``: the recovered shape against the true one, empty where it was
    given.
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

    def record(self, component: str, views: Views, measure: Measure) -> None:
        """Measure every view of a component; store means, values per image, reasons and counts."""
        means = self.metrics if component in COMPONENTS else self.variants
        if isinstance(views, str):
            means[component] = dict.fromkeys(measure.names)
            self.reasons.update({f"{component}.{name}": views for name in measure.names})
            return

        groups = views if isinstance(views, dict) else {"": views}
        measured = {light: [measure.of(view) for view in group] for light, group in groups.items()}
        means[component] = {}
        for name in measure.names:
            values = {light: [one.values[name] for one in group] for light, group in measured.items()}
            mean = mean_over_images([value for group in values.values() for value in group])
            means[component][name] = mean
            why = {light: reason for light, group in values.items() if (reason := explain(group))}
            if mean is None or math.isinf(mean):
                text = "; ".join(f"{light}: {reason}" if light else reason for light, reason in why.items())
                self.reasons[f"{component}.{name}"] = text or "no image"
            for light, reason in why.items():
                self.reasons[".".join(filter(None, ("per_image", component, light, name)))] = reason

        by_light = {
            light: {name: [one.values[name] for one in group] for name in measure.names} for light, group in measured.items()
        }
        self.per_image[component] = by_light.get("", by_light)
        pairs = [view for group in groups.values() for view in group]
        everything = [one for group in measured.values() for one in group]
        self.counts[component] = {
            "views": len(pairs),
            "views_without_scored_pixel": sum(_is_left_out(one) for one in everything),
            "scored_pixels": sum(int(view.mask.sum()) for view in pairs),
            "uncovered_pixels": sum(view.uncovered for view in pairs),
            "clipped_prediction": sum(one.clipped_prediction for one in everything),
            "clipped_truth": sum(one.clipped_truth for one in everything),
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


def _is_left_out(one: Measured) -> bool:
    """Whether a view enters no mean, whatever is predicted there."""
    return all(isinstance(value, NoScoredPixel) for value in one.values.values())
