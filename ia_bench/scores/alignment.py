"""Fix the scale that images under unknown light cannot tell: albedo times s under light over s is the same image.

Each rule takes linear values of the scored pixels of the *whole test set*, predicted and true (N, 3) float64, and returns the
numerator and the denominator (3,) of the scale: one scale for the test set, never one per image.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ia_bench.scores.metrics import NoScoredPixel, Undefined

Quotient = tuple[np.ndarray, np.ndarray]


def mean_rgb(predicted: np.ndarray, true: np.ndarray) -> Quotient:
    """One scale that makes the mean over pixels *and* channels equal (the paper's): s = mean(true) / mean(predicted).

    A light colour baked into the albedo stays visible, as it should.
    """
    return np.full(3, true.mean()), np.full(3, predicted.mean())


def per_channel(predicted: np.ndarray, true: np.ndarray) -> Quotient:
    """One scale per channel, s_c = mean(true_c) / mean(predicted_c).

    It hides a colour cast, so it is recorded as a variant and is not the score.
    """
    return true.mean(axis=0), predicted.mean(axis=0)


def least_squares(predicted: np.ndarray, true: np.ndarray) -> Quotient:
    """One scale that minimises sum (s predicted - true)^2: s = <predicted, true> / <predicted, predicted>."""
    return np.full(3, (predicted * true).sum()), np.full(3, (predicted * predicted).sum())


def median_ratio(predicted: np.ndarray, true: np.ndarray) -> Quotient:
    """One scale per channel, the median over pixels of true / max(predicted, 1e-6), as TensoIR's evaluation has it.

    It hides a colour cast as :func:`per_channel` does. Undefined where half of a channel is predicted black.
    """
    return np.median(true / np.maximum(predicted, 1e-6), axis=0), (np.median(predicted, axis=0) > 0).astype(float)


def unaligned(predicted: np.ndarray, true: np.ndarray) -> Quotient:
    """No scale at all: albedo is compared, and relit, as it is predicted."""
    return np.ones(3), np.ones(3)


ALIGNMENTS: dict[str, Callable[[np.ndarray, np.ndarray], Quotient]] = {
    "mean_rgb": mean_rgb,
    "per_channel": per_channel,
    "least_squares": least_squares,
    "median_ratio": median_ratio,
    "none": unaligned,
}
VARIANTS = ("mean_rgb", "per_channel", "least_squares")
"""Alignments that are recorded beside the protocol's own."""


def scale(alignment: str, predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """The factor (3,) float64 that multiplies linear predicted albedo. Raises Undefined where there is none."""
    if not predicted.size:
        raise NoScoredPixel
    if not np.isfinite(predicted).all():
        raise Undefined("the prediction is not finite")
    numerator, denominator = ALIGNMENTS[alignment](predicted.astype(np.float64), true.astype(np.float64))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # judged on the next line
        found = numerator / denominator
    if not (np.isfinite(found) & (found > 0)).all():
        raise Undefined(f"no positive scale: the truth over the prediction is {numerator} / {denominator}")
    return found
