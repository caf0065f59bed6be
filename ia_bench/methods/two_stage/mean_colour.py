"""A prediction as the mean colour of the object: what images leave open most, and a prior tells best.

Images of one object under one unknown light hardly tell its colour from the light's: albedo times c and light divided by
c give the same diffuse images. A prior whose details are poor may still know that one colour.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.targets import Targets

BETA = 0.1
"""Log ratio below which the loss is a parabola: a constant pull toward an estimate of a batch would never come to rest."""


class MeanColour:
    """The loss: smooth L1 of log(mean albedo of the fit / mean albedo of the targets), per channel, over a batch of pixels.

    Linear means over the pixels that the object fills, so that the target is an average over everything the prior has said,
    pale and saturated, shaded and lit, from all sides. ``free_scale``: only the ratios between the channels count.
    """

    def __init__(self, problem: Problem, targets: Targets, *, free_scale: bool) -> None:
        self._target = targets.values["albedo"]
        self._weight = targets.weights["albedo"] * (problem.gbuffer.face >= 0).all(1)[:, None]
        self._free_scale = free_scale

    def mean(self) -> Tensor | None:
        """Mean albedo (3,) of all targets; None where no pixel that was asked about is filled by the object."""
        total = self._weight.sum()
        return (self._weight * self._target).sum(0) / total if float(total) > 0 else None

    def loss(self, albedo: Tensor, pixels: Tensor) -> Tensor:
        """The loss of G-buffer entries (B,) whose rendered albedo (B, 3) is given."""
        weight = self._weight[pixels]
        fit, target = ((weight * values).sum(0).clamp_min(1e-8) for values in (albedo, self._target[pixels]))
        ratio = torch.log(fit / target)
        if self._free_scale:
            ratio = ratio - ratio.mean()
        return F.smooth_l1_loss(ratio, torch.zeros_like(ratio), beta=BETA)
