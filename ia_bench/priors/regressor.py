"""The deterministic alternative: one network pass from image to albedo and specular shading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.conditioned import Conditioned
from ia_bench.priors.diffusion.learned import Framed, LearnedPrior
from ia_bench.priors.diffusion.network import MaterialNetwork


class RegressorPrior(LearnedPrior):
    """The paper's "data-driven" alternative: a network of the diffusion prior's size, data and training, without noise.

    It returns the mean of what the image could mean, always the same; so there is nothing to guide. Options as in
    :class:`ia_bench.priors.diffusion.learned.LearnedPrior`.
    """

    kind = "regressor"
    stochastic = False

    @torch.no_grad()
    def _predict(self, network: MaterialNetwork, framed: Framed, render: Mapping[str, Tensor], cost: Counter[str]) -> Tensor:
        if render:
            raise InputError("prior=regressor: it cannot be guided (guidable is false), found guidance")
        model = Conditioned(network, chunk=self.batch, bf16=self.bf16)
        predicted = model.regress(framed.condition)
        cost["network_calls"] += model.calls
        return predicted
