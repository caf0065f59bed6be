"""The sRGB transfer function (IEC 61966-2-1), for numpy arrays and for torch tensors, whose gradients stay finite at zero."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Array = TypeVar("Array", np.ndarray, "Tensor")


def where(condition: Any, value: Any, other: Any) -> Any:  # noqa: ANN401 (arrays of numpy or tensors of torch)
    """``value`` where the condition is true, else ``other``: numpy's or torch's, which is imported for tensors alone."""
    if isinstance(condition, np.ndarray | np.generic | bool):
        return np.where(condition, value, other)
    import torch

    return torch.where(condition, value, other)


def linear_to_srgb(linear: Array) -> Array:
    """Encode linear values >= 0 (negative ones continue the linear segment); 1 maps to 1."""
    encoded: Array = where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clip(0.0031308) ** (1 / 2.4) - 0.055)
    return encoded


def srgb_to_linear(encoded: Array) -> Array:
    """Decode sRGB values; the inverse of :func:`linear_to_srgb`."""
    linear: Array = where(encoded <= 0.04045, encoded / 12.92, ((encoded.clip(0.04045) + 0.055) / 1.055) ** 2.4)
    return linear


def tone_map(radiance: Tensor) -> Tensor:
    """Encode log(1 + x) as sRGB: compresses highlights, keeps gradients at black finite. For any radiance >= 0."""
    return linear_to_srgb(radiance.log1p())
