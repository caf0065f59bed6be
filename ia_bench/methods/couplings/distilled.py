"""``coupling=distilled``: score distillation (SDS, Poole et al. 2023), the paper's alternative to sampling."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ia_bench.common.ranges import Number
from ia_bench.methods.contract import PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.base import WeightedCoupling, encode


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
        self._weight, self._encoding = samples.weight, problem.prior.info.encoding
        self._estimates = {name: encode(value, self._encoding[name]) for name, value in samples.values.items()}
        self._uses = self.uses(frozenset(samples.values))

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("albedo", render.albedo, pixels)

    def specular_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        return self._half_square("specular", render.specular, pixels)

    def _half_square(self, name: str, prediction: Tensor, pixels: Tensor) -> Tensor:
        difference = encode(prediction, self._encoding[name]) - self._estimates[name][pixels]
        return (self._weight[pixels] * (0.5 * difference**2)).mean()
