"""What guidance sees of an image: the image itself, or a Gaussian blur of it that is exact up to the image's border."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.errors import InputError


@dataclass(frozen=True)
class GaussianBlur:
    """The operator A: a Gaussian blur of ``sigma`` >= 0 pixels over the last two axes; 0 is the identity.

    The image is continued by reflection (half-sample even), so A is symmetric, keeps the mean, and is diagonal in the
    type-II cosine transform: frequency k of n has eigenvalue exp(-(sigma pi k / n)^2 / 2). There is no kernel to truncate.
    """

    sigma: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sigma >= 0 and math.isfinite(self.sigma)):
            raise InputError(f"blur: expected a standard deviation >= 0 in pixels, found {self.sigma}")

    def apply(self, image: Tensor) -> Tensor:
        """A x for ``image`` (..., H, W), same shape; differentiable."""
        if self.sigma == 0:
            return image
        rows, columns = (_blur_matrix(size, self.sigma, image.device, image.dtype) for size in image.shape[-2:])
        return rows @ image @ columns

    def eigenvalues(self, like: Tensor) -> Tensor:
        """The eigenvalues of A, (H, W) in (0, 1], by vertical and horizontal frequency, for images ``like`` (..., H, W)."""
        rows, columns = (_eigenvalues(size, self.sigma) for size in like.shape[-2:])
        return (rows[:, None] * columns).to(like)


def cosine_transform(image: Tensor) -> Tensor:
    """Orthonormal type-II discrete cosine transform over the last two axes, as products with two small matrices."""
    rows, columns = (_cosine_matrix(size, image.device, image.dtype) for size in image.shape[-2:])
    return rows @ image @ columns.T


def inverse_cosine_transform(spectrum: Tensor) -> Tensor:
    """The inverse (and transpose) of :func:`cosine_transform`."""
    rows, columns = (_cosine_matrix(size, spectrum.device, spectrum.dtype) for size in spectrum.shape[-2:])
    return rows.T @ spectrum @ columns


def _eigenvalues(size: int, sigma: float) -> Tensor:
    return torch.exp(-0.5 * (sigma * math.pi / size * torch.arange(size, dtype=torch.float64)).square())


@functools.lru_cache(maxsize=32)
def _cosine_matrix(size: int, device: torch.device, dtype: torch.dtype) -> Tensor:
    """(size, size): row k is the basis function cos(pi k (i + 1/2) / size), normalised."""
    index = torch.arange(size, dtype=torch.float64)
    basis = torch.cos(math.pi / size * index[:, None] * (index + 0.5)) * math.sqrt(2 / size)
    basis[0] *= math.sqrt(0.5)
    return basis.to(device, dtype)


@functools.lru_cache(maxsize=32)
def _blur_matrix(size: int, sigma: float, device: torch.device, dtype: torch.dtype) -> Tensor:
    basis = _cosine_matrix(size, torch.device("cpu"), torch.float64)
    return (basis.T @ (_eigenvalues(size, sigma)[:, None] * basis)).to(device, dtype)
