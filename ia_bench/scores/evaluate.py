"""Score the predictions of one run against the truth under one protocol: all the numbers of metrics.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ia_bench.scenes.images import Images
from ia_bench.scores.alignment import ALIGNMENTS, Alignment
from ia_bench.scores.components import ROUGHNESS_MEASURE, Measure, image_measure
from ia_bench.scores.predictions import Pair, Predictions, pairs, stacked
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.result import Scores

IMAGE_METRICS = ("psnr", "ssim", "lpips")
NOT_PREDICTED = "not predicted"


def albedo_scale(predicted: Images, true: Images, protocol: Protocol) -> Alignment:
    """Return the scale that multiplies the linear albedo *before* it is relit: the protocol's, from all given views."""
    return ALIGNMENTS[protocol.alignment](*stacked(pairs(predicted, true, protocol.mask_threshold, "albedo")))


def score(predictions: Predictions, truth: Predictions, protocol: Protocol) -> Scores:
    """Compute every number of the protocol, and its variants.

    A component that is not predicted, or not finite in a scored pixel, gets None and a reason. Raises ValueError where
    predictions and truth differ in views, shapes or lights, or the truth is missing or not finite.
    """
    scores = _score(predictions, truth, protocol, IMAGE_METRICS)
    albedo = _paired(predictions.albedo, truth.albedo, "albedo", protocol)
    other: Encoding = "linear" if protocol.albedo_encoding == "srgb" else "srgb"
    in_other, as_usual = image_measure(protocol, other, ("psnr",)), _albedo_measure(protocol, IMAGE_METRICS)
    scores.record(f"albedo_{other}", albedo, in_other)
    for name in ALIGNMENTS:
        aligned = _aligned(scores, name, albedo)
        if name == protocol.alignment:
            scores.record(f"aligned_albedo_{other}", aligned, in_other)
        else:
            scores.record(f"aligned_albedo_{name}", aligned, as_usual)
    return scores


def score_quick(predictions: Predictions, truth: Predictions, protocol: Protocol) -> dict[str, float | None]:
    """Return the metric columns of curve.csv, PSNRs and roughness error only, of whichever components are given.

    None stands for a component that is not given, and for an undefined value.
    """
    metrics = _score(predictions, truth, protocol, ("psnr",)).metrics
    return {f"{component}_{name}": value for component, values in metrics.items() for name, value in values.items()}


def _score(predictions: Predictions, truth: Predictions, protocol: Protocol, names: tuple[str, ...]) -> Scores:
    """Score the five components, taking the image metrics ``names``."""
    scores = Scores(protocol)
    of_albedo = _albedo_measure(protocol, names)
    of_radiance = image_measure(protocol, protocol.radiance_encoding, names)

    albedo = _paired(predictions.albedo, truth.albedo, "albedo", protocol)
    scores.record("albedo", albedo, of_albedo)
    aligned = _aligned(scores, protocol.alignment, albedo)
    scores.record("aligned_albedo", aligned, of_albedo)
    rendered = _paired(predictions.view_synthesis, truth.view_synthesis, "view_synthesis", protocol)
    scores.record("view_synthesis", rendered, of_radiance)
    relit = _paired_by_light(predictions.relighting, truth.relighting, protocol)
    # What is relit is the aligned albedo: where there is none, its reason is the reason.
    scores.record("relighting", aligned if relit == NOT_PREDICTED and isinstance(aligned, str) else relit, of_radiance)
    rough = _paired(predictions.roughness, truth.roughness, "roughness", protocol)
    scores.record("roughness", rough, ROUGHNESS_MEASURE)
    return scores


def _albedo_measure(protocol: Protocol, names: tuple[str, ...]) -> Measure:
    return image_measure(protocol, protocol.albedo_encoding, names)


def _paired(predicted: Images | None, true: Images | None, what: str, protocol: Protocol) -> list[Pair] | str:
    if predicted is None:
        return NOT_PREDICTED
    if true is None:
        raise ValueError(f"{what}: predicted, but the scene has no ground truth for it")
    return pairs(predicted, true, protocol.mask_threshold, what)


def _paired_by_light(
    predicted: Mapping[str, Images] | None, true: Mapping[str, Images] | None, protocol: Protocol
) -> dict[str, list[Pair]] | str:
    if predicted is None:
        return NOT_PREDICTED
    if true is None or sorted(predicted) != sorted(true):
        raise ValueError(f"relighting: expected the lights {sorted(true or ())}, found {sorted(predicted)}")
    return {
        light: pairs(predicted[light], true[light], protocol.mask_threshold, f"relighting under {light}")
        for light in sorted(true)
    }


def _aligned(scores: Scores, name: str, albedo: list[Pair] | str) -> list[Pair] | str:
    """Scale the predicted albedo by one of the alignments and note the scale."""
    if isinstance(albedo, str):
        return albedo
    alignment = ALIGNMENTS[name](*stacked(albedo))
    scores.albedo_scales[name] = None if alignment.scale is None else alignment.scale.tolist()
    if alignment.scale is None:
        return f"albedo cannot be aligned: {alignment.reason}"
    return [replace(view, predicted=view.predicted * alignment.scale) for view in albedo]
