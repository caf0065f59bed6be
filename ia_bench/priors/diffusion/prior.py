"""``prior=diffusion``: conditional diffusion models of albedo and specular shading behind the prior's contract."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import NotNegative, Number, Positive, UnitInterval
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.diffusion.guidance import DEFAULT_PRIOR_VARIANCE, Guidance, Norm, Pull, Rule
from ia_bench.priors.diffusion.learned import Framed, LearnedPrior
from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.diffusion.patches import sample_large
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample, seeded_noise

PATCH_REDUCTION = 3.0
"""Image pixels a native pixel may stand for before patches are worth their cost: up to 2.9 single views gain nothing."""
DISTILLED_LEVELS = (0.02, 0.98)
"""Share of the schedule from which score distillation draws its noise level; the ends teach nothing (DreamFusion)."""


@dataclass(kw_only=True, eq=False)
class DiffusionPrior(LearnedPrior):
    """Samples of p(albedo, specular | image), the paper's sections 3.2 and 3.3.

    Its cost counts guided estimates, those whose step was cut, and images that were predicted in patches.

    Attributes:
        steps, eta: The steps and the eta of the sampler (DDIM 0 ... ancestral 1).
        patches: Predict the image in overlapping native-size patches at full resolution (the paper's equation 6) instead of
            reducing it to the native size; "auto": images that would be reduced more than 3 times.
        guidance_rule, guidance_norm, guidance_strength, prior_variance: How stage 2's samples are drawn toward the current
            renders, each component by a norm of its own (equation 8; :mod:`ia_bench.priors.diffusion.guidance`).
    """

    kind = "diffusion"
    stochastic = True
    steps: Number = 3
    eta: UnitInterval = 0.0
    patches: bool | Literal["auto"] = "auto"
    guidance_rule: Rule = "variance"
    guidance_norm: Norm = "squared"
    guidance_strength: NotNegative = 10.0
    prior_variance: Positive = DEFAULT_PRIOR_VARIANCE

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = min(config.timesteps for config in self._configs)
        if self.steps > longest:
            raise InputError(f"prior.options.steps: expected at most {longest} (the schedule's length), found {self.steps}")
        self._settings = SamplerSettings(steps=self.steps, eta=self.eta)
        self._guidance = Guidance((), self.guidance_rule, self.guidance_norm, self.prior_variance)

    def _options(self) -> dict[str, Any]:
        guidance = [self.guidance_rule, self.guidance_norm, self.prior_variance, self.guidance_strength]
        return {"sampler": [self.steps, self.eta], "guidance": guidance, "patches": self.patches}

    def _patched(self, reduction: float) -> bool:
        return reduction > (PATCH_REDUCTION if self.patches == "auto" else 1) and self.patches is not False

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :class:`ia_bench.priors.diffusion.learned.LearnedPrior`; without strength a guided sample is an unguided one."""
        return super().sample(observations, seed=seed, guidance=guidance if self.guidance_strength else None)

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        """See :class:`ia_bench.priors.contract.Distiller`; ``renders`` holds every component that this prior provides.

        Always at the native size, for one evaluation cannot agree between patches.
        """
        return self._through(observations, seed, renders, self._distill, reduced=True)

    @torch.no_grad()
    def _distill(self, network: MaterialNetwork, framed: Framed, render: Mapping[str, Tensor], cost: Counter[str]) -> Tensor:
        """Each image noised to its own random level and denoised in one evaluation."""
        model, schedule = self._conditioned(network, cost), network.config.noise_schedule
        clean = torch.cat([render[name] for name in network.config.components], 1)
        low, high = (round(share * len(schedule)) for share in DISTILLED_LEVELS)
        noise = seeded_noise(framed.seeds, (clean.shape[1], clean.shape[2], clean.shape[3]))().to(clean)
        estimates = []
        for one, seed in zip(torch.arange(len(clean)).split(1), framed.seeds, strict=True):
            t = low + derive_seed(seed, 1) % (high - low)
            level = float(schedule.alpha_bar[t])
            noisy = level**0.5 * clean[one] + (1 - level) ** 0.5 * noise[one]
            estimates.append(model.bind(framed.condition[one])(noisy, t))
        return torch.cat(estimates).clamp(-1, 1)

    def _predict(self, network: MaterialNetwork, framed: Framed, render: Mapping[str, Tensor], cost: Counter[str]) -> Tensor:
        config, condition, bind = network.config, framed.condition, self._conditioned(network, cost).bind
        schedule, like = config.noise_schedule, (config.output_channels, config.size, config.size)
        cost.update(guided_estimates=0, guided_cut=0)
        guidance = replace(self._guidance, cost=cost)
        if render:  # toward its components, inside the mask, each by its own norm; the others are left to follow
            inside = (framed.masks > 0).float()[:, None].to(self._device)
            absent = torch.zeros_like(condition[:, :3])
            target = torch.cat([render.get(name, absent) for name in config.components], 1)
            weights = [torch.cat([(inside * (own == name)).expand_as(absent) for own in config.components], 1) for name in render]
            guidance = replace(guidance, pulls=tuple(Pull(target, self.guidance_strength, weight) for weight in weights))
        if condition.shape[-1] > config.size:
            cost["patched_images"] += len(framed.frames)
            masks, manner = framed.masks[:, None], (self._settings, guidance)
            return sample_large(bind, schedule, like, condition, masks, framed.seeds, *manner, batch=self.batch)
        denoise = guidance.guiding(bind(condition), schedule)
        return sample(denoise, schedule, (len(condition), *like), framed.seeds, self._settings, device=self._device)
