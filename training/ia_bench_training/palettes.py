"""Colours of procedural materials: linear Rec.709 reflectances in [MIN_ALBEDO, MAX_ALBEDO]."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from ia_bench.scenes.color import srgb_to_linear

MIN_ALBEDO, MAX_ALBEDO = 0.02, 0.95


def from_hsv(hue: np.ndarray, saturation: np.ndarray, value: np.ndarray) -> np.ndarray:
    """HSV in display encoding, each (N,), to linear RGB (N, 3)."""
    k = np.mod(np.array([5.0, 3.0, 1.0]) + hue[:, None] * 6, 6)
    encoded = value[:, None] * (1 - saturation[:, None] * np.minimum(k, 4 - k).clip(0, 1))
    return np.asarray(srgb_to_linear(encoded)).clip(MIN_ALBEDO, MAX_ALBEDO)


def palette(rng: Generator, count: int) -> np.ndarray:
    """``count`` colours that may stand beside each other, (count, 3) linear.

    Natural ones (greys, whites, woods, stones, earths, leaves) are half of all; the others are paints and prints.
    """
    kind = rng.choice(["grey", "earth", "mild", "leaf", "pastel", "strong", "contrast", "print", "dark"], p=_SHARES)
    value = rng.uniform(0.25, 0.95, count)
    if kind == "grey":
        hue, saturation = rng.random(count), rng.uniform(0, 0.1, count)
    elif kind == "earth":
        hue, saturation = rng.normal(0.075, 0.025, count), rng.uniform(0.15, 0.7, count)
    elif kind == "mild":
        hue, saturation = rng.random() + rng.normal(0, 0.07, count), rng.uniform(0.05, 0.4, count)
    elif kind == "leaf":
        hue, saturation = rng.normal(0.27, 0.06, count), rng.uniform(0.2, 0.75, count)
    elif kind == "pastel":
        hue, saturation, value = rng.random(count), rng.uniform(0.1, 0.35, count), rng.uniform(0.75, 0.98, count)
    elif kind == "strong":
        hue, saturation = rng.random() + rng.normal(0, 0.05, count), rng.uniform(0.5, 1, count)
    elif kind == "contrast":  # two opposite hues and neutrals
        hue = rng.random() + 0.5 * rng.integers(0, 2, count) + rng.normal(0, 0.03, count)
        saturation = rng.uniform(0.3, 0.95, count) * (rng.random(count) < 0.75)
    elif kind == "print":  # pure colours on white, with black at times
        pure = rng.random(count) < 0.6
        hue, saturation = rng.random(count), np.where(pure, rng.uniform(0.6, 1, count), rng.uniform(0, 0.12, count))
        ink = rng.uniform(0.12, 0.3, count)
        vivid = rng.uniform(0.45, 0.95, count)
        neutral = np.where(rng.random(count) < 0.3, ink, rng.uniform(0.85, 0.98, count))
        value = np.where(pure, vivid, neutral)
    else:
        hue, saturation, value = rng.random(count), rng.uniform(0, 0.6, count), rng.uniform(0.15, 0.4, count)
    return from_hsv(np.mod(hue, 1), saturation, value)


_SHARES = np.array([0.16, 0.17, 0.13, 0.05, 0.07, 0.12, 0.12, 0.13, 0.05])
