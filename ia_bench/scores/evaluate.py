"""Score the predictions of one run against the truth under one protocol: all the numbers of metrics.json.

A value per image is a float or the :class:`~ia_bench.scores.metrics.Undefined` that explains its absence. The mean exists only
where every image has a value: a mean over the images that happened to work would reward failing on the hard ones. Views without
a scored pixel, which are the same for every method, are left out. An infinite PSNR (identical images) makes the mean infinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ia_bench.scenes.images import Images
from ia_bench.scores import comparison
from ia_bench.scores.comparison import VARIANTS, Pair, Pairs, Predictions, scale, stacked
from ia_bench.scores.error_split import VisibleSurface, split
from ia_bench.scores.metrics import (
    COMPONENTS,
    CURVE_METRICS,
    MEASURED,
    METRIC_OF,
    METRICS,
    Compared,
    Metric,
    NoScoredPixel,
    Undefined,
    without_noise,
)
from ia_bench.scores.protocol import Encoding, Protocol

REDRAWN = "_reference"
"""How the names of scores end that are of exported textures, drawn by the reference renderer beside a method's own pictures."""

COUNTED = ("scored_pixels", "uncovered_pixels", "clipped_prediction", "clipped_truth")
"""What is counted of every component; of one with noise also the views whose error is below it, ``at_noise_floor``."""

Value = float | Undefined
Views = dict[str, Pairs] | str  # of one component by novel light, "" for what has none; or why there are none
NO_TRUTH = {
    "albedo": "the scene has no true albedo in its test views",
    "view_synthesis": "the scene has no held-out view under its training light",
    "relighting": "the scene has no view under a novel light whose map it knows",
    "roughness": "the scene has no true roughness in its test views",
    "light": "the scene does not know its training light",
    "log_light": "the scene does not know its training light",
}


OF_METAL = "metallic"
"""A component of scenes alone that say which parts of them are metal: of others nothing is recorded."""

NEVER_WHOLE = ("roughness", "metallic", "light", "log_light", "albedo_error")
"""Components that have no score of whole images: there is nothing around them."""


@dataclass(frozen=True)
class Scores:
    """Numbers of one run, each a number, +inf (PSNR of identical images) or None, with the reason of every non-number.

    What each holds is said of :class:`ia_bench.runs.record.RunRecord`, which keeps them; ``counts["textures"]`` has texels, and
    those that are drawn rougher than they are; of a scene whose light turns, also whether theirs does (1 or 0).
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
        names = [metric.name for metric in metrics]
        means = (self.metrics if component in COMPONENTS else self.variants)[component] = dict.fromkeys(names)
        if isinstance(views, str):
            self.reasons.update({f"{component}.{name}": views for name in names})
            return

        measured = {light: [_measured(view, compare, metrics) for view in group] for light, group in views.items()}
        by_light = {light: {name: [found[name] for found, _ in group] for name in names} for light, group in measured.items()}
        self.per_image[component] = by_light.get("", by_light)
        for name in names:
            mean = means[name] = mean_over_images([value for values in by_light.values() for value in values[name]])
            why = {light: reason for light, values in by_light.items() if (reason := explain(values[name]))}
            if mean is None or math.isinf(mean):
                text = "; ".join(f"{light}: {reason}" if light else reason for light, reason in why.items())
                self.reasons[f"{component}.{name}"] = text or "no image"
            for light, reason in why.items():
                self.reasons[".".join(filter(None, ("per_image", component, light, name)))] = reason

        everything = [one for group in measured.values() for one in group]
        empty = [all(isinstance(value, NoScoredPixel) for value in found.values()) for found, _ in everything]
        self.counts[component] = {"views": len(everything), "views_without_scored_pixel": sum(empty)}
        for name in dict.fromkeys((*COUNTED, *(name for _, count in everything for name in count))):
            self.counts[component][name] = sum(count.get(name, 0) for _, count in everything)

    def as_dict(self) -> dict[str, Any]:
        """Return what metrics.json stores; what is no finite number becomes null, its reason stands in ``reasons``."""
        numbers = {name: finite_or_none(value) for name, value in vars(self).items() if name != "protocol"}
        return {"protocol": self.protocol.label, "protocol_description": self.protocol.describe(), **numbers}


def score(
    predictions: Predictions, truth: Predictions, protocol: Protocol, *, renderer: str = "", shown: VisibleSurface | None = None
) -> Scores:
    """Compute every number of the protocol, and its variants. ``shown``: the surface in the pixels of the albedo's views.

    A component without truth, one that is not predicted, and one that is not finite in a scored pixel get None and a reason.

    Raises:
        ValueError: Predictions and truth differ in views, shapes or lights, or the truth is not finite.
    """
    scores = Scores(protocol, renderer)
    views = record_all(scores, predictions, truth, MEASURED, shown=shown)
    psnr = [METRIC_OF["albedo.psnr"]]
    for name, of in views.items():
        if name not in NEVER_WHOLE:
            over_white = partial(comparison.over_white, protocol=protocol, encoding=_encoding(name, protocol))
            scores.record(f"{name}_whole_image", of, over_white, psnr)
    of_photograph = partial(comparison.exposed, protocol=protocol, encoding=_encoding("view_synthesis", protocol))
    scores.record("view_synthesis_exposed", views["view_synthesis"], of_photograph, psnr)
    other: Encoding = "linear" if protocol.albedo_encoding == "srgb" else "srgb"
    in_other = partial(comparison.pictures, protocol=protocol, encoding=other)
    for name in ("albedo", "aligned_albedo"):
        scores.record(f"{name}_{other}", views[name], in_other, psnr)
    if protocol.comparison.hdr_clip is not None:
        for name in ("view_synthesis", "relighting"):
            scores.record(f"{name}_hdr", views[name], partial(comparison.linear_pictures, protocol=protocol), psnr)
    for name in VARIANTS:
        if name != protocol.alignment:
            aligned = _aligned(scores, name, views["albedo"])
            _record_one(scores, "aligned_albedo", aligned, METRICS, f"_{name}")
            scores.record(f"aligned_albedo_{name}_{other}", aligned, in_other, psnr)
    return scores


def score_quick(predictions: Predictions, truth: Predictions, protocol: Protocol) -> dict[str, float | None]:
    """Return the metric columns of curve.csv; None stands for an undefined value."""
    scores = Scores(protocol)
    record_all(scores, predictions, truth, CURVE_METRICS)
    return {metric.column: scores.metrics[metric.component][metric.name] for metric in CURVE_METRICS}


def albedo_scale(predicted: Images, true: Images, protocol: Protocol) -> np.ndarray | None:
    """The scale (3,) that multiplies the linear albedo *before* it is relit: the protocol's, from all given views."""
    try:
        return scale(protocol.alignment, *stacked(Pairs(predicted, true, protocol.mask_threshold, "albedo")))
    except Undefined:
        return None


def record_all(
    scores: Scores,
    predictions: Predictions,
    truth: Predictions,
    metrics: tuple[Metric, ...],
    suffix: str = "",
    shown: VisibleSurface | None = None,
) -> dict[str, Views]:
    """Score the components by those of ``metrics`` that belong to each; return what was compared."""
    protocol = scores.protocol
    views: dict[str, Views] = {name: _paired(predictions, truth, name, protocol) for name in NO_TRUTH}
    if truth.metallic is not None:
        views[OF_METAL] = _paired(predictions, truth, OF_METAL, protocol)
    views["aligned_albedo"] = aligned = _aligned(scores, protocol.alignment, views["albedo"], suffix)
    if metrics is MEASURED:
        views["albedo_error"] = _split(views["albedo"], shown, protocol)
    relit = predictions.relighting is not None or truth.relighting is None or protocol.alignment == "none"
    if isinstance(aligned, str) and not relit:
        views["relighting"] = aligned  # what is relit is the aligned albedo: where there is none, its reason is the reason
    found = {name: views[name] for name in dict.fromkeys(metric.component for metric in metrics) if name in views}
    for component, of in found.items():
        _record_one(scores, component, of, metrics, suffix)
    return found


def _encoding(component: str, protocol: Protocol) -> Encoding:
    return protocol.albedo_encoding if "albedo" in component else protocol.radiance_encoding


def _record_one(scores: Scores, component: str, views: Views, metrics: tuple[Metric, ...], suffix: str) -> None:
    """One component, as the protocol compares it."""
    protocol, encoding = scores.protocol, _encoding(component, scores.protocol)
    ways: dict[str, Callable[..., Compared]] = {
        **dict.fromkeys(("roughness", "metallic"), comparison.scalar),
        **dict.fromkeys(("log_light", "albedo_error"), comparison.as_it_is),
        "light": partial(comparison.of_object, encoding=encoding),
    }
    compare = partial(ways.get(component, partial(comparison.pictures, encoding=encoding)), protocol=protocol)
    scores.record(component + suffix, views, compare, [metric for metric in metrics if metric.component == component])


def _paired(predictions: Predictions, truth: Predictions, what: str, protocol: Protocol) -> Views:
    """The views of a component (for relighting by light), or why there are none."""
    predicted, true = getattr(predictions, what), getattr(truth, what)
    if true is None or true == {}:
        return truth.undefined.get(what, NO_TRUTH[what])
    if predicted is None:
        return predictions.undefined.get(what, f"the method does not predict {what.replace('_', ' ')}")
    if what != "relighting":
        return {"": Pairs(predicted, true, protocol.mask_threshold, what)}
    if sorted(predicted) != sorted(true):
        raise ValueError(f"relighting: expected the lights {sorted(true)}, found {sorted(predicted)}")
    return {name: Pairs(predicted[name], true[name], protocol.mask_threshold, f"relighting under {name}") for name in sorted(true)}


def _aligned(scores: Scores, alignment: str, albedo: Views, suffix: str = "") -> Views:
    """Scale the predicted albedo by one of the alignments and note the scale."""
    if isinstance(albedo, str):
        return albedo
    try:
        factor = scale(alignment, *stacked(albedo[""]))
    except Undefined as reason:
        scores.albedo_scales[alignment + suffix] = None
        return f"albedo cannot be aligned: {reason}"
    scores.albedo_scales[alignment + suffix] = factor.tolist()
    return {"": replace(albedo[""], factor=factor)}


def _split(albedo: Views, shown: VisibleSurface | None, protocol: Protocol) -> Views:
    """The views of albedo with the parts of their error, or why it is not split."""
    if isinstance(albedo, str):
        return albedo
    if shown is None:
        return "the scene has no true mesh"
    try:
        return {"": replace(albedo[""], parts=split(albedo[""], shown, protocol))}
    except Undefined as reason:
        return str(reason)


def drawn_scale(scales: Mapping[str, list[float] | None], alignment: str) -> list[float] | None:
    """The RGB scale (3,) of the textures that pictures show: their own where they were exported, else that of the method's maps.

    ``scales``: ``albedo_scales`` of the scores. None where there is neither: the albedo could not be aligned.
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
    where, said = dict[str, list[int]](), []
    for index, value in enumerate(values):
        if isinstance(value, Undefined) or math.isinf(value):
            where.setdefault(str(value) if isinstance(value, Undefined) else "identical", []).append(index)
    for reason, found in where.items():
        images = f"image{'s' * (len(found) > 1)} {', '.join(map(str, found))}"
        said.append(f"{reason} ({'every image' if len(found) == len(values) else images})")
    return "; ".join(said) or None


def finite_or_none(tree: object) -> object:
    """Copy nested dicts and lists, with None for every Undefined and every number that is not finite (JSON has neither)."""
    if isinstance(tree, Mapping):
        return {key: finite_or_none(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [finite_or_none(value) for value in tree]
    if isinstance(tree, Undefined) or (isinstance(tree, float) and not math.isfinite(tree)):
        return None
    return tree


def _measured(
    view: Pair, compare: Callable[[Pair], Compared], metrics: Sequence[Metric]
) -> tuple[dict[str, Value], dict[str, int]]:
    """The value of every metric by its name, or why there is none; and what is counted.

    That is COUNTED, of which the last two are values that were clipped, and of noisy views whether the error is below its noise.
    """
    counted = dict(zip(COUNTED, (int(view.mask.sum()), int((view.mask & (view.coverage[0] == 0)).sum()), 0, 0), strict=True))
    if view.spread is not None:
        counted["at_noise_floor"] = 0
    try:
        compared = compare(view)
    except Undefined as reason:
        return dict.fromkeys((metric.name for metric in metrics), reason), counted
    values: dict[str, Value] = {}
    for metric in metrics:
        try:
            values[metric.name] = metric.of(compared)
        except Undefined as reason:
            values[metric.name] = reason
    counted["clipped_prediction"], counted["clipped_truth"] = compared.clipped
    if compared.spread is not None:
        counted["at_noise_floor"] = int(without_noise(compared)[1])
    return values, counted
