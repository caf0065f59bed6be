"""Noise levels of a diffusion model, and DDIM and ancestral sampling at them; each image is a function of its own seed alone.

Notation (variance preserving): x_t = sqrt(alpha_bar_t) x_0 + sqrt(1 - alpha_bar_t) eps, eps ~ N(0, I), t = 0 ... T - 1,
alpha_bar decreasing in t. The noise level relative to the signal is sigma_t = sqrt(1 / alpha_bar_t - 1). The sampler knows
neither network nor guidance: it asks a :data:`Denoise` for the estimate of x_0, and whoever makes that knows conditions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision

Denoise = Callable[[Tensor, int], Tensor]
"""(noisy x_t (N, C, H, W), timestep t) -> estimate of x_0 (N, C, H, W), unclipped; guided, it is drawn to something."""
Spacing = Literal["trailing", "leading"]
SCHEDULE_KEYS = ("num_train_timesteps", "beta_start", "beta_end", "beta_schedule", "trained_betas", "rescale_betas_zero_snr")
"""What of a ``diffusers`` scheduler's config decides the noise levels."""
Noise = Callable[[], Tensor]
"""Standard normal noise (N, C, H, W), fresh at every call: the start first, then that of each step that takes any."""


@dataclass(frozen=True, eq=False)
class NoiseSchedule:
    """``alpha_bar`` (T,) float64 on the CPU, strictly decreasing, in [0, 1); 0 (no signal left) can only be its last entry.

    Raises InputError where that is not so.
    """

    alpha_bar: Tensor

    def __post_init__(self) -> None:
        levels = torch.as_tensor(self.alpha_bar, dtype=torch.float64, device="cpu")
        if levels.ndim != 1 or len(levels) == 0:
            raise InputError(f"noise schedule: expected alpha_bar of shape (T,), T >= 1, found {tuple(levels.shape)}")
        if not bool(((levels >= 0) & (levels < 1)).all()) or not bool((levels.diff() < 0).all()):
            raise InputError("noise schedule: expected alpha_bar in [0, 1), strictly decreasing in t")
        object.__setattr__(self, "alpha_bar", levels)

    def __len__(self) -> int:
        return len(self.alpha_bar)

    @classmethod
    def from_diffusers(cls, config: Mapping[str, Any]) -> NoiseSchedule:
        """The schedule of a ``diffusers`` DDPM or DDIM scheduler with this ``config`` (its ``scheduler_config.json``).

        Only ``num_train_timesteps``, the betas and ``rescale_betas_zero_snr`` are taken; how to sample is the sampler's
        own setting. Raises InputError for a config that diffusers refuses.
        """
        import_torchvision()
        from diffusers import DDPMScheduler

        try:
            scheduler: Any = DDPMScheduler(**{key: config[key] for key in SCHEDULE_KEYS if key in config})
        except (NotImplementedError, TypeError, ValueError) as error:
            raise InputError(f"scheduler config: expected one that diffusers' DDPMScheduler takes, found {error}") from error
        return cls(scheduler.alphas_cumprod)

    def timesteps(self, steps: int, spacing: Spacing = "trailing") -> list[int]:
        """``steps`` distinct timesteps of this schedule, descending; ``steps`` is in 1 ... T.

        "trailing" starts at T - 1, so at the noise that the sampler's start is drawn from: round(T (steps - i) / steps) - 1.
        "leading", as in the original code (steps_offset 1): i floor(T / steps) + 1, which starts below T - 1. Lin et al.,
        "Common diffusion noise schedules and sample steps are flawed" (2024), table 2. Raises InputError.
        """
        count = len(self)
        if not 1 <= steps <= count:
            raise InputError(f"steps: expected 1 ... {count} (the schedule's length), found {steps}")
        if spacing == "trailing":
            return [round(count * (steps - i) / steps) - 1 for i in range(steps)]
        stride = count // steps
        offset = min(1, count - 1 - (steps - 1) * stride)  # all T steps leave no room for an offset
        return [i * stride + offset for i in reversed(range(steps))]


def image_behind(noise: Tensor, noisy: Tensor, alpha_bar: float) -> Tensor:
    """The estimate (x_t - b ``noise``) / a of x_0 that an estimate of the noise in ``noisy`` x_t stands for; needs alpha_bar > 0.

    a = sqrt(alpha_bar), b = sqrt(1 - alpha_bar), the difference taken in double precision: it is 1e-8 at sigma = 1e-4.
    """
    return (noisy - (1 - alpha_bar) ** 0.5 * noise) / alpha_bar**0.5


@dataclass(frozen=True)
class SamplerSettings:
    """``steps``: network evaluations a sample, 1 ... T. ``eta``: share of fresh noise, 0 (DDIM) ... 1 (ancestral, DDPM).

    ``spacing``: see :meth:`NoiseSchedule.timesteps`. ``clip``: range of the data; every estimate of x_0 is clipped to it
    after guidance, and the noise direction follows from the clipped one, so that samples lie in it whatever the network
    and the guidance do. None for data without a range (latents), where nothing bounds a sample.
    """

    steps: int = 10
    eta: float = 0.0
    spacing: Spacing = "trailing"
    clip: tuple[float, float] | None = (-1.0, 1.0)


@torch.no_grad()
def sample(
    denoise: Denoise,
    schedule: NoiseSchedule,
    shape: tuple[int, int, int, int],
    seeds: Sequence[int] | Noise,
    settings: SamplerSettings,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Draw ``shape`` (N, C, H, W) samples in the network's space; ``seeds``: one per image, or where their noise comes from.

    Each step replaces x_t by (Song et al. 2021, "Denoising diffusion implicit models", equation 12, with eps eliminated)

        x_s = sqrt(alpha_bar_s) x_0 + sqrt(1 - alpha_bar_s - f^2) (x_t - sqrt(alpha_bar_t) x_0) / sqrt(1 - alpha_bar_t) + f z
        f^2 = eta^2 (1 - alpha_bar_s) / (1 - alpha_bar_t) (1 - alpha_bar_t / alpha_bar_s),   z ~ N(0, I)

    where x_0 is the estimate, clipped. The last step has alpha_bar_s = 1 and returns x_0 itself.

    An image's start and the noise of its steps come from one generator of its own on the CPU, so its sample depends on its
    seed (and its condition) alone: neither on the batch nor on the device. ``denoise`` is called ``settings.steps`` times, without
    gradients.
    """
    noise = seeds if callable(seeds) else seeded_noise(seeds, shape[1:])
    noisy = noise().to(device, dtype)
    timesteps = schedule.timesteps(settings.steps, settings.spacing)
    levels = [float(schedule.alpha_bar[t]) for t in timesteps] + [1.0]
    for t, level, following in zip(timesteps, levels[:-1], levels[1:], strict=True):
        x0 = denoise(noisy, t)
        if settings.clip is not None:
            x0 = x0.clamp(*settings.clip)
        keep, fresh = step_weights(level, following, settings.eta)
        noisy = (keep * noisy).add_(x0, alpha=math.sqrt(following) - keep * math.sqrt(level))
        if fresh > 0:
            noisy.add_(noise().to(device, dtype), alpha=fresh)
    return noisy


def step_weights(level: float, following: float, eta: float) -> tuple[float, float]:
    """(weight of x_t, weight f of fresh noise) of the step from alpha_bar ``level`` to ``following``; see :func:`sample`.

    The weight of x_t is sqrt(1 - alpha_bar_s - f^2) / sqrt(1 - alpha_bar_t), written without the difference, which cancels
    near eta = 1: there it is alpha_bar_t (1 - alpha_bar_s) / (alpha_bar_s (1 - alpha_bar_t)) under the root.
    """
    shrink = (1 - following) / (1 - level)
    ancestral = (level / following) * shrink
    keep = math.sqrt(shrink * ((1 - eta**2) + eta**2 * ancestral))
    return keep, eta * math.sqrt(shrink * (1 - level / following))


def seeded_noise(seeds: Sequence[int], shape: tuple[int, int, int]) -> Noise:
    """Noise (N, *``shape``) on the CPU, image i from a generator of its own seeded by ``seeds[i]``."""
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    return lambda: torch.stack([torch.randn(shape, generator=generator) for generator in generators])
