"""A sum of spherical Gaussians: what it is, how much of it there is, and two of them multiplied.

    G(v) = mu exp(lambda (v . xi - 1))    with unit axis xi, sharpness lambda > 0 and amplitude mu

(Wang et al. 2009, "All-frequency rendering of dynamic, spatially-varying reflectance".)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import texel_centres

OPPOSED = 1e-8  # added under the root: two lobes of one sharpness and opposite axes multiply to a constant, of sharpness 0


class SphericalGaussians(NamedTuple):
    """M lobes, (M, ...) each; or M lobes of each of N points, (N, M, ...).

    Attributes:
        axis: (..., M, 3) unit directions.
        sharpness: (..., M), positive.
        amplitude: (..., M, 3) radiance at the axis.
    """

    axis: Tensor
    sharpness: Tensor
    amplitude: Tensor

    def energy(self) -> Tensor:
        """The integral over the sphere of every lobe, 2 pi mu / lambda (1 - exp(-2 lambda)): (..., M, 3)."""
        return self.amplitude * lobe_integral(self.sharpness)[..., None]

    def radiance(self, directions: Tensor) -> Tensor:
        """The sum of M lobes in unit ``directions`` (D, 3): (D, 3). Or, of those of each of N points, (N, D, 3) in (N, D, 3)."""
        values = torch.exp(self.sharpness[..., None, :] * (directions @ self.axis.transpose(-1, -2) - 1))
        return values @ self.amplitude

    def cosines(self, directions: Tensor) -> Tensor:
        """The cosine between every lobe's axis and one unit direction of each of N points, (N, 3): (N, M)."""
        return directions @ self.axis.T if self.axis.ndim == 2 else (self.axis @ directions[..., None])[..., 0]

    def weighted(self, weights: Tensor) -> Tensor:
        """The sum over the lobes of their amplitudes times ``weights`` (N, M): (N, 3)."""
        return weights @ self.amplitude if self.amplitude.ndim == 2 else (weights[..., None, :] @ self.amplitude)[..., 0, :]


def lobe_integral(sharpness: Tensor) -> Tensor:
    """The integral over the sphere of a lobe of amplitude 1."""
    return -2 * math.pi * torch.expm1(-2 * sharpness) / sharpness


def product(first: Tensor, second: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor]:
    """Sharpness and amplitude of the product of two lobes of amplitude 1 with these sharpnesses, ``cosine`` between their axes.

    The product is a lobe again: its sharpness is the length of lambda_1 xi_1 + lambda_2 xi_2, its axis the direction of that,
    and its amplitude exp(sharpness - lambda_1 - lambda_2), whose exponent is written so that nothing cancels.
    """
    sharpness = torch.sqrt((first - second) ** 2 + 2 * first * second * (1 + cosine) + OPPOSED)
    return sharpness, torch.exp(2 * first * second * (cosine - 1) / (sharpness + first + second))


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


FINEST_ROWS = 256  # of the map that is averaged down to smaller ones: narrow lobes must not fall between the texels' centres
DIRECTIONS_AT_ONCE = 2**14


@dataclass(frozen=True)
class SphericalGaussianEnvironment:
    """See :class:`ia_bench.light.environment.Environment`; ``lobes`` are M, the same for all points."""

    lobes: SphericalGaussians

    def radiance(self, directions: Tensor) -> Tensor:
        """See :class:`ia_bench.light.environment.Environment`."""
        return torch.cat([self.lobes.radiance(part) for part in directions.split(DIRECTIONS_AT_ONCE)])

    def latlong(self, height: int) -> Tensor:
        """See :class:`ia_bench.light.environment.Environment`: radiance at texels' centres, averaged from a finer map."""
        fine = height * max(1, -(-FINEST_ROWS // height))
        centres = texel_centres(fine, 2 * fine).to(self.lobes.axis)
        return LatLongEnvironment(self.radiance(centres.reshape(-1, 3)).reshape(*centres.shape[:2], -1)).latlong(height)


def fibonacci_axes(count: int) -> Tensor:
    """``count`` unit directions spread evenly over the sphere along a golden spiral, (count, 3)."""
    place = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * place + 1) / count
    azimuth = place * (math.pi * (3 - math.sqrt(5)))
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * torch.cos(azimuth), radius * torch.sin(azimuth), z], -1).float()
