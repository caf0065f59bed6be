"""What a prior says is what renders should look like.

``coupling=targets`` is the paper's way (equation 5); ``coupling=distilled`` its alternative to sampling: score distillation (SDS,
Poole et al. 2023).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from ia_bench.common.ranges import Number
from ia_bench.material.textures import fetch
from ia_bench.methods.contract import PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.base import WeightedCoupling, encode

ALIGNMENT_PIXELS = 65_536  # about this many pixels of all views, and their share of those asked about, estimate the alignment
ALIGNMENT_PERIOD = 10  # steps between two estimates


@dataclass(eq=False)
class Targets(WeightedCoupling):
    """The losses |SSI(k_hat, k_s) - k_s| in the prior's encoding and |S_hat - S_s| of tone-mapped radiance.

    The alignment SSI is an inner minimisation that alternates with the optimiser's steps, so it carries no gradient.

    Attributes:
        ssi: How renders are aligned with the prior's albedo, per view: "scale", "scale_shift" (mean and spread, as in Ranftl et
            al. 2022) or "none".
        sets_albedo: Whether a fit starts from the prior's albedo, averaged over the views on the surface.
    """

    ssi: Literal["scale_shift", "scale", "none"] = "scale"
    sets_albedo: bool = True

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Encode the targets, and choose the pixels that estimate the alignment, of those that the prior was asked about."""
        super().prepare(samples, problem)
        gbuffer = self._gbuffer = problem.gbuffer
        self._alignment: ViewAlignment | None = None
        if "albedo" not in samples.values:
            return
        self._encoding = problem.prior.info.encoding["albedo"]
        self._target = encode(samples.values["albedo"], self._encoding)
        asked = samples.weight[:, 0] > 0
        covered = torch.nonzero(asked & gbuffer.filled)[:, 0]
        usable = covered if len(covered) else torch.nonzero(asked)[:, 0]
        chosen = usable[:: max(1, len(gbuffer.pixel) // ALIGNMENT_PIXELS)]
        face = gbuffer.face[chosen]
        uv = problem.renderer.surface.uv(face.clamp_min(0).long(), gbuffer.barycentric[chosen])
        self._aligning = (face >= 0)[..., None], uv, samples.values["albedo"][chosen], gbuffer.view(chosen)

    @torch.no_grad()
    def update(self, texture: Tensor, step: int) -> None:
        """Estimate the alignment where it is due; a pure function of step and texture."""
        if "albedo" in self._uses and (self._alignment is None or step % ALIGNMENT_PERIOD == 0):
            hit, uv, target, view = self._aligning
            prediction = (fetch(texture, uv) * hit).sum(1) / hit.shape[1]
            self._alignment = align_views(prediction, target, view, self._gbuffer.shape[0], self.ssi)

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        assert self._alignment is not None, "update() comes first"
        gbuffer = self._gbuffer
        coverage = (gbuffer.face[pixels] >= 0).float().mean(1, keepdim=True)
        aligned = self._alignment(render.albedo, gbuffer.view(pixels), coverage)
        difference = encode(aligned, self._encoding) - self._target[pixels]
        return (self._weight[pixels] * difference.abs()).mean()

    def state(self) -> dict[str, Tensor]:
        """The alignment between two updates; nothing before the first."""
        return {} if self._alignment is None else dict(vars(self._alignment))

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take it over; checkpoints are read on the CPU."""
        device = self._weight.device
        self._alignment = ViewAlignment(**{name: value.to(device) for name, value in state.items()}) if state else None


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
    spread_prediction = per_view_mean((prediction - mean_prediction[view][:, None]).abs())
    spread_target = per_view_mean((target - mean_target[view][:, None]).abs())
    usable = spread_prediction > 1e-4
    scale = torch.where(usable, spread_target / spread_prediction.clamp_min(1e-4), ones)
    return ViewAlignment(scale, mean_target - scale * mean_prediction)


@dataclass(eq=False)
class Distilled(WeightedCoupling):
    """The loss |x_hat - x_d|^2 / 2 in the prior's encoding, whose gradient is that of SDS; x_d is what it denoised x_hat to.

    Nothing is aligned: the estimate was made from the render itself.

    Attributes:
        period: Steps between two distillations.
        views: Views in each.
    """

    period: Number = 10
    views: Number = 4

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Encode the estimates."""
        self._weight, self._encoding, self._unit = samples.weight, problem.prior.info.encoding, problem.photographs.unit
        self._estimates = {name: self._encoded(name, value) for name, value in samples.values.items()}
        self._uses = self.uses(frozenset(samples.values))

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("albedo", render.albedo, pixels)

    def specular_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("specular", render.specular, pixels)

    def _half_square(self, name: str, prediction: Tensor, pixels: Tensor) -> Tensor:
        difference = self._encoded(name, prediction) - self._estimates[name][pixels]
        return (self._weight[pixels] * (0.5 * difference**2)).mean()

    def _encoded(self, name: str, values: Tensor) -> Tensor:
        return encode(values * (self._unit if name == "specular" else 1.0), self._encoding[name])
