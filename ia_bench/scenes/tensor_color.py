"""The sRGB transfer function (IEC 61966-2-1) for torch tensors, with gradients that stay finite at zero."""

from __future__ import annotations

import torch
from torch import Tensor


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Encode linear values >= 0 (negative ones continue the linear segment); 1 maps to 1."""
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """Decode sRGB values; the inverse of :func:`linear_to_srgb`."""
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)
