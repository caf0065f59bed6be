"""A spherical Gaussian integrated over the hemisphere above a surface, with and without the cosine."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench_baselines.common.spherical_gaussians.lobes import product

# n . v ~ COSINE_AMPLITUDE exp(COSINE_SHARPNESS (n . v - 1)) - COSINE_OFFSET above the horizon, to .008 (Meder and Bruederlin 2018)
COSINE_SHARPNESS, COSINE_AMPLITUDE, COSINE_OFFSET = 0.0315, 32.7080, 31.7003


def hemisphere_integral(sharpness: Tensor, cosine: Tensor) -> Tensor:
    """The integral of a lobe of amplitude 1 over the hemisphere around n, with ``cosine`` = n . xi.

    Meder and Bruederlin (2018, "Hemispherical Gaussians for accurate light integration") interpolate between the integrals of a
    lobe at the pole, A_u = 2 pi (1 - q) / lambda with q = exp(-lambda), and at the opposite pole, A_b = q A_u:

        A_b + (A_u - A_b) s,    s = (e^t e^(t c) - 1) / ((e^t - 1) (e^(t c) + 1)) = (1 + tanh(t c / 2) / tanh(t / 2)) / 2

    The second form of s is the first one, and has no exponential that overflows. The error is at most 1.1 per cent of the lobe.
    """
    steepness = sharpness.sqrt() * sharpness * (1.6988 * sharpness + 10.8438) / ((sharpness + 6.2201) * sharpness + 10.2415)
    ratio = torch.tanh(steepness * cosine / 2) / torch.tanh(steepness / 2)
    q = torch.exp(-sharpness)
    return -math.pi * torch.expm1(-sharpness) / sharpness * (1 + q + (1 - q) * ratio)


def clamped_cosine_integral(sharpness: Tensor, cosine: Tensor) -> Tensor:
    """The integral of a lobe of amplitude 1 times max(n . v, 0), with ``cosine`` = n . xi.

    The cosine is a lobe less a constant, and the product of two lobes is one. Lobes below the horizon come out slightly below
    0, by about a thousandth: it is their sum that may be held at 0.
    """
    pole = sharpness.new_tensor(COSINE_SHARPNESS)
    narrowed, amplitude = product(sharpness, pole, cosine)
    leaning = (sharpness * cosine + COSINE_SHARPNESS) / narrowed  # cosine between n and the product's axis
    with_cosine = COSINE_AMPLITUDE * amplitude * hemisphere_integral(narrowed, leaning)
    return with_cosine - COSINE_OFFSET * hemisphere_integral(sharpness, cosine)
