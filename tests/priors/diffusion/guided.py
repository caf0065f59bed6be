"""Images, denoisers and pulls of the tests of sampling and guidance."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from ia_bench.priors.diffusion.guidance import Guidance, Pull
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule, SamplerSettings, sample

SIZE = (5, 7)


def wide_schedule(steps: int) -> NoiseSchedule:
    """Noise levels from 1e-4 to 1e4."""
    return NoiseSchedule(1 / (1 + torch.logspace(-4, 4, steps, dtype=torch.float64).square()))


def gaussian_denoiser(schedule: NoiseSchedule, mean: float, variance: float) -> Denoise:
    """E[x_0 | x_t] in closed form."""

    def denoise(noisy: Tensor, t: int) -> Tensor:
        level = float(schedule.alpha_bar[t])
        return (variance * math.sqrt(level) * noisy + (1 - level) * mean) / (variance * level + 1 - level)

    return denoise


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def coupled(noisy: Tensor, t: int) -> Tensor:
    """A smooth non-linear denoiser whose pixels depend on each other."""
    return torch.tanh(noisy + 0.5 * noisy.roll(1, -1) - 0.3 * noisy.roll(2, -2) * noisy)


def toward(target: Tensor, strength: float, weight: Tensor | None = None, sigma: float = 0.0, **rule: object) -> Guidance:
    return Guidance((Pull(target, strength, weight, sigma),), **rule)


def pulls_of(*kinds: str, strength: float = 30.0) -> list[Pull]:
    """``kinds``: "identity", "blur", perhaps "weighted", perhaps by "channel"; half of the weights and channel 1 are zero."""
    pulls = []
    for i, kind in enumerate(kinds):
        weight = random(2, 1, *SIZE, seed=10 + i).clamp(min=0) if "weighted" in kind else None
        if "channel" in kind:
            weight = weight * torch.tensor([1.0, 0.0, 2.0])[:, None, None]
        pulls.append(Pull(random(2, 3, *SIZE, seed=20 + i), strength / (i + 1), weight, 1.5 if "blur" in kind else 0.0))
    return pulls


def affine_map(guidance: Guidance, steps: int, mean: float, variance: float, clip: None = None) -> tuple[Tensor, Tensor]:
    """The mean and the covariance of guided DDIM samples, one channel: start noise 0, then every unit vector."""
    count = math.prod(SIZE)
    init = torch.cat([torch.zeros(1, count), torch.eye(count)]).reshape(count + 1, 1, *SIZE).double()
    everywhere = guidance.pulls[0].through(lambda image: image.expand(count + 1, *image.shape[1:]))
    schedule = wide_schedule(steps)
    denoise = replace(guidance, pulls=(everywhere,)).guiding(gaussian_denoiser(schedule, mean, variance), schedule)
    settings, shape = SamplerSettings(steps, clip=clip), tuple(init.shape)
    found = sample(denoise, schedule, shape, lambda: init, settings, dtype=torch.float64).reshape(-1, count)
    slope = found[1:] - found[0]
    return found[0], slope.T @ slope
