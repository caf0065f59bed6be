"""Data whose exact denoiser is known: x_0 ~ N(mean, variance), every value by itself."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.priors.diffusion.sampler import Denoise
from ia_bench.priors.diffusion.schedule import NoiseSchedule


def wide_schedule(steps: int) -> NoiseSchedule:
    """Noise levels from 1e-4 to 1e4."""
    return NoiseSchedule(1 / (1 + torch.logspace(-4, 4, steps, dtype=torch.float64).square()))


def gaussian_denoiser(schedule: NoiseSchedule, mean: float, variance: float) -> Denoise:
    """E[x_0 | x_t] in closed form."""

    def denoise(noisy: Tensor, t: int) -> Tensor:
        level = float(schedule.alpha_bar[t])
        return (variance * math.sqrt(level) * noisy + (1 - level) * mean) / (variance * level + 1 - level)

    return denoise
