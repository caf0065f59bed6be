"""A sum of spherical Gaussians: what it is, how much of it there is, and two of them multiplied.

    G(v) = mu exp(lambda (v . xi - 1))    with unit axis xi, sharpness lambda > 0 and amplitude mu

(Wang et al. 2009, "All-frequency rendering of dynamic, spatially-varying reflectance".)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

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
        shares = torch.exp(self.sharpness[..., None, :] * (directions @ self.axis.transpose(-1, -2) - 1))
        return shares @ self.amplitude

    def cosines(self, directions: Tensor) -> Tensor:
        """The cosine between every lobe's axis and one unit direction of each of N points, (N, 3): (N, M)."""
        return directions @ self.axis.T if self.axis.ndim == 2 else (self.axis @ directions[..., None])[..., 0]

    def weighted(self, shares: Tensor) -> Tensor:
        """The sum over the lobes of their amplitudes times ``shares`` (N, M): (N, 3)."""
        return shares @ self.amplitude if self.amplitude.ndim == 2 else (shares[..., None, :] @ self.amplitude)[..., 0, :]


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
