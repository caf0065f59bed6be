"""Images, denoisers and pulls of the tests of guidance."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from gaussian_prior import gaussian_denoiser, wide_schedule
from torch import Tensor

from ia_bench.priors.diffusion.guidance import Guidance, Pull
from ia_bench.priors.diffusion.operators import GaussianBlur
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample

SIZE = (5, 7)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def coupled(noisy: Tensor, t: int) -> Tensor:
    """A smooth non-linear denoiser whose pixels depend on each other."""
    return torch.tanh(noisy + 0.5 * noisy.roll(1, -1) - 0.3 * noisy.roll(2, -2) * noisy)


# ----- the implicit rule ------------------------------------------------------------------------------------------------------
def pulls_of(*kinds: str, strength: float = 30.0) -> list[Pull]:
    """``kinds``: "identity", "blur", perhaps "weighted", perhaps by "channel"; half of the weights and channel 1 are zero."""
    pulls = []
    for i, kind in enumerate(kinds):
        weight = random(2, 1, *SIZE, seed=10 + i).clamp(min=0) if "weighted" in kind else None
        if "channel" in kind:
            weight = weight * torch.tensor([1.0, 0.0, 2.0])[:, None, None]
        operator = GaussianBlur(1.5 if "blur" in kind else 0.0)
        pulls.append(Pull(random(2, 3, *SIZE, seed=20 + i), strength / (i + 1), weight, operator))
    return pulls


def affine_map(guidance: Guidance, steps: int, mean: float, variance: float, clip: None = None) -> tuple[Tensor, Tensor]:
    """The mean and the covariance of guided DDIM samples, one channel: start noise 0, then every unit vector."""
    count = math.prod(SIZE)
    init = torch.cat([torch.zeros(1, count), torch.eye(count)]).reshape(count + 1, 1, *SIZE).double()
    everywhere = guidance.pulls[0].through(lambda image: image.expand(count + 1, *image.shape[1:]))
    guidance = replace(guidance, target=everywhere.target, weight=everywhere.weight)
    schedule = wide_schedule(steps)
    denoise, settings = gaussian_denoiser(schedule, mean, variance), SamplerSettings(steps, clip=clip)
    shape = tuple(init.shape)
    found = sample(denoise, schedule, shape, lambda: init, settings, guidance, dtype=torch.float64).reshape(-1, count)
    slope = found[1:] - found[0]
    return found[0], slope.T @ slope
