"""What training makes small."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.scenes.color import srgb_to_linear

FAINTEST = 3e-4  # squared error below which little is gained: 35 dB
MAX_SCALE = 10.0  # of a prediction to the level of the truth


def weighted_error(difference: Tensor, masks: Tensor, *, level: float, background: float) -> Tensor:
    """The mean square of ``difference`` (N, C, H, W), in which an error of the colour and one of the structure weigh differently.

    Inside ``masks`` (N, H, W) each channel's mean over an image counts ``level``, the rest counts 1; pixels outside count
    ``background``. No such weights move the minimum of a square, which is the expectation of the truth.
    """
    inside = (masks[:, None] > 0).float()
    pixels = inside.sum((2, 3), keepdim=True)
    mean = (difference * inside).sum((2, 3), keepdim=True) / pixels.clamp_min(1)
    inner = ((difference - mean).square() * inside).sum() + level * (mean.square() * pixels).sum()
    outer = (difference.square() * (1 - inside)).sum()
    count = (pixels + background * (masks[0].numel() - pixels)).sum() * difference.shape[1]
    return (inner + background * outer) / count


def log_error(predicted: Tensor, target: Tensor, masks: Tensor, *, aligned: bool) -> Tensor:
    """The mean over images of log(e + FAINTEST), e the mean squared error of a linear component.

    PSNR is -10 log10 e: an image that is easy counts as much as one that is not.

    Args:
        predicted: (N, 3, H, W), encoded.
        target: (N, 3, H, W), encoded.
        masks: (N, H, W), coverage; pixels of more than one half count.
        aligned: Whether a prediction is first scaled to the mean of its truth, so that a level which no image tells counts nothing.
    """
    inside = (masks > 0.5)[:, None].float()
    found, true = (srgb_to_linear((0.5 + 0.5 * each).clamp(0, 1)) * inside for each in (predicted, target))
    if aligned:
        means = [each.sum((1, 2, 3), keepdim=True) for each in (found, true)]
        found = (means[1] / means[0].clamp_min(1e-3)).clamp(1 / MAX_SCALE, MAX_SCALE) * found
    error = (found - true).square().sum((1, 2, 3)) / (3 * inside.sum((1, 2, 3))).clamp_min(1)
    return torch.log(error + FAINTEST).mean()
