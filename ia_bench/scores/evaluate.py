"""Score the predictions of one run against the truth under one protocol: all the numbers of metrics.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ia_bench.scenes.images import Images
from ia_bench.scores.alignment import ALIGNMENTS, VARIANTS, Alignment
from ia_bench.scores.components import hdr_measure, image_measure, roughness_measure, whole_image_measure
from ia_bench.scores.predictions import Pair, Predictions, pairs, stacked
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.result import COMPONENTS, Scores, Views

IMAGE_METRICS = ("psnr", "ssim", "lpips")
NO_TRUTH = {
    "albedo": "the scene has no true albedo in its test views",
    "view_synthesis": "the scene has no held-out view under its training light",
    "relighting": "the scene has no view under a novel light whose map it knows",
    "roughness": "the scene has no true roughness in its test views",
}


def not_predicted(component: str) -> str:
    """The reason why a component of a scene that has its truth is undefined."""
    return f"the method does not predict {component.replace('_', ' ')}"


def albedo_scale(predicted: Images, true: Images, protocol: Protocol) -> Alignment:
    """Return the scale that multiplies the linear albedo *before* it is relit: the protocol's, from all given views."""
    return ALIGNMENTS[protocol.alignment](*stacked(pairs(predicted, true, protocol.mask_threshold, "albedo")))


def score(predictions: Predictions, truth: Predictions, protocol: Protocol, *, renderer: str = "") -> Scores:
    """Compute every number of the protocol, and its variants.

    A component without truth, one that is not predicted, and one that is not finite in a scored pixel get None and a reason.

    Raises:
        ValueError: Predictions and truth differ in views, shapes or lights, or the truth is not finite.
    """
    scores = Scores(protocol, renderer)
    views = _record(scores, predictions, truth, IMAGE_METRICS)
    for name, of in views.items():
        if name != "roughness":
            encoding = protocol.albedo_encoding if "albedo" in name else protocol.radiance_encoding
            scores.record(f"{name}_whole_image", of, whole_image_measure(encoding))
    other: Encoding = "linear" if protocol.albedo_encoding == "srgb" else "srgb"
    as_usual, in_other = (image_measure(protocol, one, names) for one, names in (
        (protocol.albedo_encoding, IMAGE_METRICS), (other, ("psnr",))))  # fmt: skip
    for name in ("albedo", "aligned_albedo"):
        scores.record(f"{name}_{other}", views[name], in_other)
    if protocol.comparison.hdr_clip is not None:
        for name in ("view_synthesis", "relighting"):
            scores.record(f"{name}_hdr", views[name], hdr_measure(protocol))
    for name in VARIANTS:
        if name != protocol.alignment:
            aligned = _aligned(scores, name, views["albedo"])
            scores.record(f"aligned_albedo_{name}", aligned, as_usual)
            scores.record(f"aligned_albedo_{name}_{other}", aligned, in_other)
    return scores


def score_again(scores: Scores, predictions: Predictions, truth: Predictions, suffix: str) -> None:
    """Record the five components of other pictures of the same reconstruction as variants, named by ``suffix``."""
    _record(scores, predictions, truth, IMAGE_METRICS, suffix)


def score_quick(predictions: Predictions, truth: Predictions, protocol: Protocol) -> dict[str, float | None]:
    """Return the metric columns of curve.csv, PSNRs and roughness error only; None stands for an undefined value."""
    scores = Scores(protocol)
    _record(scores, predictions, truth, ("psnr",))
    return {f"{component}_{name}": value for component, values in scores.metrics.items() for name, value in values.items()}


def _record(
    scores: Scores, predictions: Predictions, truth: Predictions, names: tuple[str, ...], suffix: str = ""
) -> dict[str, Views]:
    """Score the five components, taking the image metrics ``names``; return what was compared."""
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
    of_albedo = image_measure(protocol, protocol.albedo_encoding, names)
    of_radiance = image_measure(protocol, protocol.radiance_encoding, names)
    measures = dict(zip(COMPONENTS, (of_albedo, of_albedo, of_radiance, of_radiance, roughness_measure(protocol)), strict=True))
    for component, pictures in views.items():
        scores.record(component + suffix, pictures, measures[component])
    return views


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


def _aligned(scores: Scores, name: str, albedo: Views, suffix: str = "") -> list[Pair] | str:
    """Scale the predicted albedo by one of the alignments and note the scale."""
    if isinstance(albedo, str):
        return albedo
    assert not isinstance(albedo, dict)  # of lights, which albedo has none of
    alignment = ALIGNMENTS[name](*stacked(albedo))
    scores.albedo_scales[name + suffix] = None if alignment.scale is None else alignment.scale.tolist()
    if alignment.scale is None:
        return f"albedo cannot be aligned: {alignment.reason}"
    return [replace(view, predicted=view.predicted * alignment.scale) for view in albedo]
