"""Noise levels of a diffusion model, which of them a sampler visits, and what an estimate of the noise says of the image.

Notation (variance preserving): x_t = sqrt(alpha_bar_t) x_0 + sqrt(1 - alpha_bar_t) eps, eps ~ N(0, I), t = 0 ... T - 1,
alpha_bar decreasing in t. The noise level relative to the signal is sigma_t = sqrt(1 / alpha_bar_t - 1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision

Denoise = Callable[[Tensor, int], Tensor]
"""(noisy x_t (N, C, H, W), timestep t) -> estimate of x_0 (N, C, H, W), unclipped; the rule "paper" differentiates it."""
Spacing = Literal["trailing", "leading"]
SCHEDULE_KEYS = ("num_train_timesteps", "beta_start", "beta_end", "beta_schedule", "trained_betas", "rescale_betas_zero_snr")
"""What of a ``diffusers`` scheduler's config decides the noise levels."""


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
        if spacing == "leading":
            stride = count // steps
            offset = min(1, count - 1 - (steps - 1) * stride)  # all T steps leave no room for an offset
            return [i * stride + offset for i in reversed(range(steps))]
        raise InputError(f"spacing: expected one of {', '.join(get_args(Spacing))}, found {spacing!r}")


def image_behind(noise: Tensor, noisy: Tensor, alpha_bar: float) -> Tensor:
    """The estimate (x_t - b ``noise``) / a of x_0 that an estimate of the noise in ``noisy`` x_t stands for; needs alpha_bar > 0.

    a = sqrt(alpha_bar), b = sqrt(1 - alpha_bar), the difference taken in double precision: it is 1e-8 at sigma = 1e-4.
    """
    return (noisy - (1 - alpha_bar) ** 0.5 * noise) / alpha_bar**0.5
