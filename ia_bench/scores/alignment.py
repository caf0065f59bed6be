"""Fix the scale that images under unknown light cannot tell: albedo times s under light over s is the same image.

Every function takes linear values of the scored pixels of the *whole test set*, ``predicted`` and ``true`` (N, 3), and
returns one :class:`Alignment`: a scale for the test set, never one per image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Alignment:
    """``scale`` (3,) float64 multiplies linear predicted albedo; None where it is undefined, with the ``reason``."""

    scale: np.ndarray | None
    reason: str | None = None


def mean_rgb(predicted: np.ndarray, true: np.ndarray) -> Alignment:
    """One scale that makes the mean over pixels *and* channels equal (the paper's): s = mean(true) / mean(predicted).

    A light colour baked into the albedo stays visible, as it should.
    """
    return _quotient(lambda p, t: (np.full(3, t.mean()), np.full(3, p.mean())), predicted, true)


def per_channel(predicted: np.ndarray, true: np.ndarray) -> Alignment:
    """One scale per channel, s_c = mean(true_c) / mean(predicted_c).

    It hides a colour cast, so it is recorded as a variant and is not the score.
    """
    return _quotient(lambda p, t: (t.mean(axis=0), p.mean(axis=0)), predicted, true)


def least_squares(predicted: np.ndarray, true: np.ndarray) -> Alignment:
    """One scale that minimises sum (s predicted - true)^2: s = <predicted, true> / <predicted, predicted>."""
    return _quotient(lambda p, t: (np.full(3, (p * t).sum()), np.full(3, (p * p).sum())), predicted, true)


def median_ratio(predicted: np.ndarray, true: np.ndarray) -> Alignment:
    """One scale per channel, the median over pixels of true / max(predicted, 1e-6), as TensoIR's evaluation has it.

    It hides a colour cast as :func:`per_channel` does. Undefined where half of a channel is predicted black.
    """
    return _quotient(
        lambda p, t: (np.median(t / np.maximum(p, 1e-6), axis=0), (np.median(p, axis=0) > 0).astype(float)), predicted, true
    )


def unaligned(predicted: np.ndarray, true: np.ndarray) -> Alignment:
    """No scale at all: albedo is compared, and relit, as it is predicted."""
    return _quotient(lambda p, t: (np.ones(3), np.ones(3)), predicted, true)


ALIGNMENTS: dict[str, Callable[[np.ndarray, np.ndarray], Alignment]] = {
    "mean_rgb": mean_rgb,
    "per_channel": per_channel,
    "least_squares": least_squares,
    "median_ratio": median_ratio,
    "none": unaligned,
}
VARIANTS = ("mean_rgb", "per_channel", "least_squares")
"""Alignments that are recorded beside the protocol's own."""


def _quotient(
    terms: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], predicted: np.ndarray, true: np.ndarray
) -> Alignment:
    """Numerator over denominator of ``terms`` in float64, or the reason why that is no scale."""
    if not predicted.size:
        return Alignment(None, "no scored pixel")
    if not np.isfinite(predicted).all():
        return Alignment(None, "the prediction is not finite")
    numerator, denominator = terms(predicted.astype(np.float64), true.astype(np.float64))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # judged on the next line
        scale = numerator / denominator
    if not (np.isfinite(scale) & (scale > 0)).all():
        return Alignment(None, f"no positive scale: the truth over the prediction is {numerator} / {denominator}")
    return Alignment(scale)
