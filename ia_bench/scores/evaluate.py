"""Score the predictions of one run against the truth under one protocol: all the numbers of metrics.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ia_bench.scenes.images import Images
from ia_bench.scores import comparison
from ia_bench.scores.alignment import VARIANTS, scale
from ia_bench.scores.columns import CURVE_METRICS, METRIC_OF, METRICS, Metric
from ia_bench.scores.metrics import Undefined
from ia_bench.scores.predictions import Pair, Predictions, pairs, stacked
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.result import Scores, Views

NO_TRUTH = {
    "albedo": "the scene has no true albedo in its test views",
    "view_synthesis": "the scene has no held-out view under its training light",
    "relighting": "the scene has no view under a novel light whose map it knows",
    "roughness": "the scene has no true roughness in its test views",
}


def score(predictions: Predictions, truth: Predictions, protocol: Protocol, *, renderer: str = "") -> Scores:
    """Compute every number of the protocol, and its variants.

    A component without truth, one that is not predicted, and one that is not finite in a scored pixel get None and a reason.

    Raises:
        ValueError: Predictions and truth differ in views, shapes or lights, or the truth is not finite.
    """
    scores = Scores(protocol, renderer)
    views = _record(scores, predictions, truth, METRICS)
    psnr = [METRIC_OF["albedo.psnr"]]
    for name, of in views.items():
        if name != "roughness":
            over_white = partial(comparison.over_white, protocol=protocol, encoding=_encoding(name, protocol))
            scores.record(f"{name}_whole_image", of, over_white, psnr)
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


def score_again(scores: Scores, predictions: Predictions, truth: Predictions, suffix: str) -> None:
    """Record the components of other pictures of the same reconstruction as variants, named by ``suffix``."""
    _record(scores, predictions, truth, METRICS, suffix)


def score_quick(predictions: Predictions, truth: Predictions, protocol: Protocol) -> dict[str, float | None]:
    """Return the metric columns of curve.csv; None stands for an undefined value."""
    scores = Scores(protocol)
    _record(scores, predictions, truth, CURVE_METRICS)
    return {metric.column: scores.metrics[metric.component][metric.name] for metric in CURVE_METRICS}


def albedo_scale(predicted: Images, true: Images, protocol: Protocol) -> np.ndarray | None:
    """The scale (3,) that multiplies the linear albedo *before* it is relit: the protocol's, from all given views."""
    try:
        return scale(protocol.alignment, *stacked(pairs(predicted, true, protocol.mask_threshold, "albedo")))
    except Undefined:
        return None


def not_predicted(component: str) -> str:
    """The reason why a component of a scene that has its truth is undefined."""
    return f"the method does not predict {component.replace('_', ' ')}"


def _record(
    scores: Scores, predictions: Predictions, truth: Predictions, metrics: tuple[Metric, ...], suffix: str = ""
) -> dict[str, Views]:
    """Score the five components by those of ``metrics`` that belong to each; return what was compared."""
    protocol = scores.protocol
    albedo = _paired(predictions.albedo, truth.albedo, "albedo", protocol)
    aligned = _aligned(scores, protocol.alignment, albedo, suffix)
    relit = _paired_by_light(predictions.relighting, truth.relighting, protocol)
    if isinstance(aligned, str) and truth.relighting is not None and protocol.alignment != "none":
        relit = aligned  # what is relit is the aligned albedo: where there is none, its reason is the reason
    views: dict[str, Views] = {
        "albedo": albedo,
        "aligned_albedo": aligned,
        "view_synthesis": _paired(predictions.view_synthesis, truth.view_synthesis, "view_synthesis", protocol),
        "relighting": relit,
        "roughness": _paired(predictions.roughness, truth.roughness, "roughness", protocol),
    }
    for component, found in views.items():
        _record_one(scores, component, found, metrics, suffix)
    return views


def _record_one(scores: Scores, component: str, views: Views, metrics: tuple[Metric, ...], suffix: str) -> None:
    """One component, as the protocol compares it."""
    mine = [metric for metric in metrics if metric.component == component]
    if component == "roughness":
        scores.record(component + suffix, views, partial(comparison.roughness, protocol=scores.protocol), mine)
    else:
        compare = partial(comparison.pictures, protocol=scores.protocol, encoding=_encoding(component, scores.protocol))
        scores.record(component + suffix, views, compare, mine)


def _encoding(component: str, protocol: Protocol) -> Encoding:
    return protocol.albedo_encoding if "albedo" in component else protocol.radiance_encoding


def _paired(predicted: Images | None, true: Images | None, what: str, protocol: Protocol) -> list[Pair] | str:
    if true is None:
        return NO_TRUTH[what]
    return not_predicted(what) if predicted is None else pairs(predicted, true, protocol.mask_threshold, what)


def _paired_by_light(
    predicted: Mapping[str, Images] | None, true: Mapping[str, Images] | None, protocol: Protocol
) -> dict[str, list[Pair]] | str:
    if not true:
        return NO_TRUTH["relighting"]
    if predicted is None:
        return not_predicted("relighting")
    if sorted(predicted) != sorted(true):
        raise ValueError(f"relighting: expected the lights {sorted(true)}, found {sorted(predicted)}")
    return {
        light: pairs(predicted[light], true[light], protocol.mask_threshold, f"relighting under {light}") for light in sorted(true)
    }


def _aligned(scores: Scores, alignment: str, albedo: Views, suffix: str = "") -> list[Pair] | str:
    """Scale the predicted albedo by one of the alignments and note the scale."""
    if isinstance(albedo, str):
        return albedo
    assert not isinstance(albedo, dict)  # of lights, which albedo has none of
    try:
        factor = scale(alignment, *stacked(albedo))
    except Undefined as reason:
        scores.albedo_scales[alignment + suffix] = None
        return f"albedo cannot be aligned: {reason}"
    scores.albedo_scales[alignment + suffix] = factor.tolist()
    return [replace(view, predicted=view.predicted * factor) for view in albedo]
