"""Measure one view of one component: encode both images the same way, then take every metric inside the mask."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ia_bench.scores import metrics
from ia_bench.scores.metrics import NoScoredPixel, Undefined
from ia_bench.scores.perceptual import lpips
from ia_bench.scores.predictions import Pair
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.reduction import Value
from ia_bench.scores.whole_images import composed, eroded, linear_images, whole_images


@dataclass(frozen=True)
class Measured:
    """``values`` by metric name, and how many values in scored pixels were clipped to [0, 1] in either image."""

    values: dict[str, Value]
    clipped_prediction: int = 0
    clipped_truth: int = 0


@dataclass(frozen=True)
class Measure:
    """The metrics ``names`` of one view: the function ``of``."""

    names: tuple[str, ...]
    of: Callable[[Pair], Measured]


def image_measure(protocol: Protocol, encoding: Encoding, names: tuple[str, ...]) -> Measure:
    """Those of psnr, ssim and lpips that ``names`` asks for, on images in ``encoding``."""
    if protocol.comparison.area == "image":
        return _whole_measure(protocol, encoding, names)
    functions: dict[str, Callable[..., float]] = {
        "psnr": metrics.psnr,
        "ssim": partial(metrics.ssim, settings=protocol.ssim),
        "lpips": partial(lpips, settings=protocol.lpips),
    }

    def of(view: Pair) -> Measured:
        predicted, clipped_prediction = metrics.encode(view.predicted, encoding, view.mask)
        true, clipped_truth = metrics.encode(view.true, encoding, view.mask)
        values = {name: _value(functions[name], predicted, true, view.mask) for name in names}
        return Measured(values, clipped_prediction, clipped_truth)

    return _where_defined(names, of)


def _whole_measure(protocol: Protocol, encoding: Encoding, names: tuple[str, ...]) -> Measure:
    """The same metrics of whole images (:mod:`ia_bench.scores.whole_images`)."""

    def of(view: Pair) -> Measured:
        pictures = whole_images(view, encoding, protocol.comparison)
        functions: dict[str, Callable[..., float]] = {
            "psnr": pictures.psnr,
            "ssim": partial(pictures.ssim, protocol.ssim),
            "lpips": partial(pictures.lpips, protocol.lpips, protocol.comparison),
        }
        return Measured({name: _value(functions[name]) for name in names}, *pictures.clipped)

    return _where_defined(names, of, protocol.comparison.erosion, everywhere=True)


def hdr_measure(protocol: Protocol) -> Measure:
    """PSNR of linear values, cut where ``protocol.comparison.hdr_clip`` says, of whole images."""

    def of(view: Pair) -> Measured:
        pictures = linear_images(view, protocol.comparison)
        return Measured({"psnr": _value(pictures.psnr)}, *pictures.clipped)

    return _where_defined(("psnr",), of, protocol.comparison.erosion, everywhere=True)


def whole_image_measure(encoding: Encoding) -> Measure:
    """PSNR over all known pixels, background included, as most papers print it: both images lie over white by their coverage."""

    def over_white(encoded: np.ndarray, coverage: np.ndarray) -> np.ndarray:
        share = coverage[..., None].clip(0, 1)
        return share * encoded + (1 - share)

    def of(view: Pair) -> Measured:
        predicted, clipped_prediction = metrics.encode(view.predicted, encoding, view.mask)
        true, clipped_truth = metrics.encode(view.true, encoding, view.mask)
        pair = over_white(predicted, view.coverage[0]), over_white(true, view.coverage[1])
        return Measured({"psnr": _value(metrics.psnr, *pair, view.known)}, clipped_prediction, clipped_truth)

    return _where_defined(("psnr",), of, everywhere=True)


def roughness_measure(protocol: Protocol) -> Measure:
    """Squared error of roughness: over the object, or over a whole image with the background's grey around the object."""
    of_object = protocol.comparison.area == "object"

    def of(view: Pair) -> Measured:
        pair, area = (view.predicted, view.true), view.mask
        if not of_object:
            pair, area = composed(view, protocol.comparison, pair), view.known
        return Measured({"mse": _value(metrics.squared_error, *pair, area)})

    return _where_defined(("mse",), of, protocol.comparison.erosion, everywhere=not of_object)


def _where_defined(
    names: tuple[str, ...], of: Callable[[Pair], Measured], erosion: int = 0, *, everywhere: bool = False
) -> Measure:
    """The function ``of``, but for views without a scored pixel, and for those whose prediction is NaN or Inf in one.

    The first is asked first, since it is the same for every prediction: in a whole picture nothing but two equal backgrounds
    would be left to compare.

    Args:
        names: The metrics of ``of``.
        of: Measures one view.
        erosion: Side of the square of pixels by which scored pixels shrink (:func:`ia_bench.scores.whole_images.eroded`).
        everywhere: NaN or Inf in any pixel of the whole picture counts, since no weight, not even 0, takes one out of a mean.
    """

    def checked(view: Pair) -> Measured:
        if not eroded(view.mask, erosion).any():
            return Measured(dict.fromkeys(names, NoScoredPixel()))
        finite = np.isfinite(view.predicted)
        broken = int((~(finite if finite.ndim == 2 else finite.all(-1))).sum()) if everywhere else view.broken
        if not broken:
            return of(view)
        reason = f"the prediction is not finite in {broken}{'' if everywhere else ' scored'} pixels"
        return Measured(dict.fromkeys(names, Undefined(reason)))

    return Measure(names, checked)


def _value(metric: Callable[..., float], *arguments: object) -> Value:
    """Return the number, or the exception that says why there is none: it is the value of that image."""
    try:
        return metric(*arguments)
    except Undefined as reason:
        return reason
