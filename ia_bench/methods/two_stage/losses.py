"""The terms of the paper's equation 5."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ia_bench.common.warp_launch import launch_summing
from ia_bench.methods.two_stage.neighbours import Neighbours
from ia_bench.methods.two_stage.warp_smoothness import differences
from ia_bench.scenes.color import linear_to_srgb


def encode(linear: Tensor, encoding: str) -> Tensor:
    """Linear values in a prior's ``encoding``, "linear" or "srgb"."""
    return linear_to_srgb(linear) if encoding == "srgb" else linear


def tone_map(radiance: Tensor) -> Tensor:
    """Encode log(1 + x) as sRGB: compresses highlights, keeps gradients at black finite. For any radiance >= 0."""
    return linear_to_srgb(torch.log1p(radiance))


def dual_buffer_loss(first: Tensor, second: Tensor, target: Tensor, cut: float, known: Tensor | None = None) -> Tensor:
    """The image term of equation 5 from two independent estimates (P, 3) of the radiance that should be ``target`` (P, 3).

    Each estimate's tone-mapped difference from the target is weighed by the other one's residual, which is the difference
    times the slope of the tone map at the target, over ``cut``, within [-1, 1]; weights carry no gradient. Far from the target
    this is the L1 of tone-mapped radiance, near it a parabola. An L1 that takes residual and gradient from the same samples
    falls with the noise of the render too, and so prefers dim lights and rough surfaces; here the residual's mean is zero where
    the mean render is right, and noise pulls nowhere (but for the skewness of what is cut). The value may be negative.
    Where ``known`` (P, 1) is False, the target is a lower bound: the residual of a brighter estimate counts as zero.
    """
    with torch.enable_grad():
        at = target.detach().clamp_min(0).requires_grad_(True)
        shown = tone_map(at)
        (slope,) = torch.autograd.grad(shown.sum(), at)
    shown = shown.detach()

    def weight(estimate: Tensor) -> Tensor:
        residual = (slope * (estimate.detach() - target) / cut).clamp(-1, 1)
        return residual if known is None else torch.where(known, residual, residual.clamp(max=0))

    return 0.5 * (weight(second) * (tone_map(first) - shown) + weight(first) * (tone_map(second) - shown)).mean()


def total_variation(log_radiance: Tensor) -> Tensor:
    """Mean over the sphere and the channels of the slope, per radian, of an equirectangular (H, W, 3) log radiance.

    The sum of slopes along and across the parallels: a light in patches costs their borders, however bright they are.
    """
    height = len(log_radiance)
    step = math.pi / height
    parallels = torch.arange(1, height, device=log_radiance.device) * step
    along = (log_radiance - log_radiance.roll(1, 1)).abs().sum()  # over sin(polar angle) for the slope, times it for the area
    across = ((log_radiance[1:] - log_radiance[:-1]).abs() * parallels.sin()[:, None, None]).sum()
    return (along + across) * step / (4 * math.pi * log_radiance.shape[-1])


@dataclass(frozen=True)
class ViewAlignment:
    """Per-view scale and shift (V,) that bring predictions to the prior's intensities: ``scale * prediction + shift``."""

    scale: Tensor
    shift: Tensor

    def __call__(self, prediction: Tensor, view: Tensor, coverage: Tensor) -> Tensor:
        """Align (P, 3) premultiplied predictions of pixels in views (P,) with coverage (P, 1)."""
        return prediction * self.scale[view][:, None] + coverage * self.shift[view][:, None]


def align_views(prediction: Tensor, target: Tensor, view: Tensor, views: int, mode: str) -> ViewAlignment:
    """The paper's SSI (Ranftl et al. 2022): bring the prediction's mean and mean absolute deviation to the target's, per view.

    (P, 3) predictions and targets of pixels in views (P,); one scale and one shift per view, common to the channels, so
    that a colour cast is not aligned away. ``mode``: "scale_shift", "scale" (ratio of means, no shift) or
    "none". A view without pixels, or whose prediction is constant (or zero, for "scale"), gets scale 1 and, for
    "scale_shift", the shift that matches the means. The result carries no gradient.
    """
    prediction, target = prediction.detach(), target.detach()
    ones = torch.ones(views, device=prediction.device)
    if mode == "none":
        return ViewAlignment(ones, torch.zeros_like(ones))
    count = torch.zeros_like(ones).index_add_(0, view, torch.ones_like(prediction[:, 0])).clamp_min(1)

    def per_view_mean(values: Tensor) -> Tensor:
        return torch.zeros_like(ones).index_add_(0, view, values.mean(-1)) / count

    mean_prediction, mean_target = per_view_mean(prediction), per_view_mean(target)
    if mode == "scale":
        usable = mean_prediction > 1e-6
        return ViewAlignment(torch.where(usable, mean_target / mean_prediction.clamp_min(1e-6), ones), torch.zeros_like(ones))
    if mode != "scale_shift":
        raise ValueError(f"ssi: expected scale_shift, scale or none, found {mode!r}")
    spread_prediction = per_view_mean((prediction - mean_prediction[view][:, None]).abs())
    spread_target = per_view_mean((target - mean_target[view][:, None]).abs())
    usable = spread_prediction > 1e-4
    scale = torch.where(usable, spread_target / spread_prediction.clamp_min(1e-4), ones)
    return ViewAlignment(scale, mean_target - scale * mean_prediction)


def smoothness(texture: Tensor, neighbours: Neighbours, pixels: Tensor) -> Tensor:
    """Mean over (B,) pixels' pairs of neighbours, and over channels, of |difference| in a texture (T, T, C) times similarity."""
    value: Tensor = _Smoothness.apply(texture, neighbours, pixels)
    return value


class _Smoothness(torch.autograd.Function):
    """Its gradient is found with it, and kept until it is asked for."""

    @staticmethod
    def forward(ctx: Any, texture: Tensor, neighbours: Neighbours, pixels: Tensor) -> Tensor:  # noqa: ANN401 (torch's context)
        ctx.gradient, totals = torch.zeros_like(texture), texture.new_zeros(len(pixels))
        launch_summing(
            differences, len(pixels), pixels, neighbours.index, neighbours.similarity, neighbours.uv, texture, totals,
            sums=[ctx.gradient], device=texture.device,
        )  # fmt: skip
        count = 2 * len(pixels) * texture.shape[-1]
        ctx.gradient /= count
        return totals.sum() / count

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:  # noqa: ANN401 (torch's context)
        return ctx.gradient * gradients[0], None, None
