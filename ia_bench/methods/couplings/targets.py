"""What a prior says is what renders should look like.

``coupling=targets`` is the paper's way (equation 5); ``coupling=distilled`` its alternative to sampling: score distillation (SDS,
Poole et al. 2023).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor

from ia_bench.common.ranges import Number
from ia_bench.methods.contract import PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.base import WeightedCoupling, encode, per_view, shown

ALIGNMENT_PIXELS = 65_536  # about this many pixels of all views, and their share of those asked about, estimate the alignment
ALIGNMENT_PERIOD = 10  # steps between two estimates


@dataclass(eq=False)
class Targets(WeightedCoupling):
    """The losses |SSI(k_hat, k_s) - k_s| in the prior's encoding and |S_hat - S_s| of tone-mapped radiance.

    The alignment SSI is a function of all pixels of a view. Its statistics are those of many pixels, taken every ALIGNMENT_PERIOD
    steps, and what they add to the gradient is part of it (:class:`SlopeOfStatistics`).

    Attributes:
        ssi: How renders are aligned with the prior's albedo, per view: "scale", "scale_shift" (mean and spread, as in Ranftl et
            al. 2022) or "none".
        sets_albedo: Whether a fit starts from the prior's albedo, averaged over the views on the surface.
        single_texels: Whether what the prior says of albedo moves single texels alone. Else the steps at coarser scales and the
            scale-ambiguity step follow it, too, and bring the colour that a prior errs by in all views faster than photographs
            can object (docs/log/supervision.md).
    """

    says_albedo: ClassVar[bool] = True
    ssi: Literal["scale_shift", "scale", "none"] = "scale"
    sets_albedo: bool = True
    single_texels: bool = False

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Encode the targets, and choose the pixels that estimate the alignment, of those that the prior was asked about."""
        super().prepare(samples, problem)
        self._problem, gbuffer = problem, problem.gbuffer
        self._alignment: ViewAlignment | None = None
        if "albedo" not in samples.values:
            return
        asked = samples.weight[:, 0] > 0
        covered = torch.nonzero(asked & gbuffer.filled)[:, 0]
        usable = covered if len(covered) else torch.nonzero(asked)[:, 0]
        chosen = self._chosen = usable[:: max(1, len(gbuffer.pixel) // ALIGNMENT_PIXELS)]
        self._statistics = Statistics.of(samples.values["albedo"][chosen], gbuffer.view(chosen), gbuffer.shape[0])

    @torch.no_grad()
    def update(self, texture: Tensor, step: int) -> None:
        """Estimate the alignment where it is due; a pure function of step and texture."""
        if "albedo" in self._uses and (self._alignment is None or step % ALIGNMENT_PERIOD == 0):
            gbuffer = self._problem.gbuffer
            prediction, view = shown(texture, self._chosen, self._problem), gbuffer.view(self._chosen)
            found = Statistics.of(prediction, view, gbuffer.shape[0])
            with torch.enable_grad():
                mean, spread = found.mean.requires_grad_(), found.spread.requires_grad_()
                alignment = align(found, self._statistics, self.ssi)
                loss = per_view(self._differences(prediction, self._chosen, alignment), view, len(mean)).sum()
                loss = loss + 0 * (mean + spread).sum()  # so that an alignment without statistics has a gradient, of zero
                by = torch.autograd.grad(loss, (mean, spread))
            self._alignment = ViewAlignment(alignment.scale.detach(), alignment.shift.detach())
            self._slope = SlopeOfStatistics(mean.detach(), found.side, *by)

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        assert self._alignment is not None, "update() comes first"
        albedo = shown(render.texture, pixels, self._problem) if self.single_texels else render.albedo
        kept = albedo.detach()
        slope = self._slope(kept, self._problem.gbuffer.view(pixels)) * (self._weight[pixels] > 0)
        through_statistics = slope * (albedo - kept)  # zero; its gradient is what counts
        return (self._differences(albedo, pixels, self._alignment) + through_statistics).mean()

    def _differences(self, prediction: Tensor, pixels: Tensor, alignment: ViewAlignment) -> Tensor:
        """How far (B, 3) predictions are from the targets of ``pixels`` when they are aligned, weighted."""
        gbuffer = self._problem.gbuffer
        coverage = (gbuffer.face[pixels] >= 0).float().mean(1, keepdim=True)
        aligned = alignment(prediction, gbuffer.view(pixels), coverage)
        return self._weight[pixels] * (self._encoded("albedo", aligned) - self._said["albedo"][pixels]).abs()

    def state(self) -> dict[str, Tensor]:
        """The alignment between two updates, with its slope; nothing before the first."""
        return {} if self._alignment is None else {**vars(self._alignment), **vars(self._slope)}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take it over; checkpoints are read on the CPU."""
        if state:
            values = {name: value.to(self._weight.device) for name, value in state.items()}
            self._alignment = ViewAlignment(values.pop("scale"), values.pop("shift"))
            self._slope = SlopeOfStatistics(**values)


@dataclass(frozen=True)
class Statistics:
    """What views' values have, (V,): ``mean``, ``spread`` (mean absolute deviation), ``side`` (mean sign of the deviations).

    All are 0 for a view without pixels.
    """

    mean: Tensor
    spread: Tensor
    side: Tensor

    @classmethod
    def of(cls, values: Tensor, view: Tensor, views: int) -> Statistics:
        """The statistics of values (P, 3) in views (P,)."""
        mean = per_view(values, view, views)
        deviations = values - mean[view][:, None]
        return cls(mean, per_view(deviations.abs(), view, views), per_view(deviations.sign(), view, views))


@dataclass(frozen=True)
class ViewAlignment:
    """Per-view scale and shift (V,) that bring predictions to the prior's intensities: ``scale * prediction + shift``."""

    scale: Tensor
    shift: Tensor

    def __call__(self, prediction: Tensor, view: Tensor, coverage: Tensor) -> Tensor:
        """Align (P, 3) premultiplied predictions of pixels in views (P,) with coverage (P, 1)."""
        return prediction * self.scale[view][:, None] + coverage * self.shift[view][:, None]


def align(prediction: Statistics, target: Statistics, mode: str) -> ViewAlignment:
    """The paper's SSI (Ranftl et al. 2022): bring the prediction's mean and mean absolute deviation to the target's, per view.

    There is one scale and one shift per view, common to the channels, so that a colour cast is not aligned away. ``mode``:
    "scale_shift", "scale" (ratio of means, no shift) or "none". A view without pixels, or whose prediction is constant (or zero,
    for "scale"), gets scale 1 and, for "scale_shift", the shift that matches the means.
    """
    ones = torch.ones_like(prediction.mean)
    if mode == "none":
        return ViewAlignment(ones, torch.zeros_like(ones))
    if mode == "scale":
        ratio = target.mean / prediction.mean.clamp_min(1e-6)
        return ViewAlignment(torch.where(prediction.mean > 1e-6, ratio, ones), torch.zeros_like(ones))
    ratio = target.spread / prediction.spread.clamp_min(1e-4)
    scale = torch.where(prediction.spread > 1e-4, ratio, ones)
    return ViewAlignment(scale, target.mean - scale * prediction.mean)


@dataclass(frozen=True)
class SlopeOfStatistics:
    """What a loss, the mean over a view's values of how far they are when aligned, changes with one value by way of the statistics.

    For a value p of N of a view, with the derivatives of the loss by the view's mean and spread, ``by_mean`` and ``by_spread``,

        N dL/dp = ``by_mean`` + ``by_spread`` (sign(p - ``mean``) - ``side``);    all (V,)

    beside the derivative at a kept alignment. That one alone pulls along what SSI leaves open: with the scale kept, a darker albedo
    is nearer, and so is one that is darker still with the next scale.
    """

    mean: Tensor
    side: Tensor
    by_mean: Tensor
    by_spread: Tensor

    def __call__(self, prediction: Tensor, view: Tensor) -> Tensor:
        """N dL/dp for (P, 3) predictions of pixels in views (P,)."""
        mean, side, by_mean, by_spread = (values[view][:, None] for values in vars(self).values())
        return by_mean + by_spread * ((prediction - mean).sign() - side)


@dataclass(eq=False)
class Distilled(WeightedCoupling):
    """The loss |x_hat - x_d|^2 / 2 in the prior's encoding, whose gradient is that of SDS; x_d is what it denoised x_hat to.

    Nothing is aligned: the estimate was made from the render itself.

    Attributes:
        period: Steps between two distillations.
        views: Views in each.
    """

    says_albedo: ClassVar[bool] = True
    period: Number = 10
    views: Number = 4

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("albedo", render.albedo, pixels)

    def specular_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("specular", render.specular, pixels)

    def _half_square(self, name: str, linear: Tensor, pixels: Tensor) -> Tensor:
        return (self._weight[pixels] * (0.5 * self._difference(name, linear, pixels) ** 2)).mean()

    def _encoded(self, name: str, linear: Tensor) -> Tensor:
        return encode(linear if name == "albedo" else linear * self._unit, self._encoding[name])
