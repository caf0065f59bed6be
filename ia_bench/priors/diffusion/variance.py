"""How uncertain a denoiser's estimate of x_0 is at each noise level: assumed from one number, or measured.

The update that weighs the estimate against a render (rule "variance" of guidance) needs r_t^2 = Var(x_0 | x_t) per value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.schedule import Denoise, NoiseSchedule

DEFAULT_PRIOR_VARIANCE = 0.1
"""Of data in [-1, 1] given the photograph: a first prior's one-step estimate of albedo had 16 dB PSNR, so 4 x 10^-1.6.

Unconditional data spread evenly over [-1, 1] would have 1/3."""


def posterior_variance(prior_variance: float | Tensor, t: int, alpha_bar: float) -> float:
    """r_t^2 = Var(x_0 | x_t) per value, at timestep ``t`` whose noise level is ``alpha_bar``.

    ``prior_variance`` is s^2 > 0, the variance of x_0 given the condition alone: r_t^2 = s^2 (1 - alpha_bar) / (s^2 alpha_bar +
    1 - alpha_bar), exact for a Gaussian prior. Or it is a table (T,) of r_t^2 itself, as :func:`measure_variance` returns.
    """
    if isinstance(prior_variance, Tensor):
        if not t < len(prior_variance):
            raise InputError(f"prior_variance: expected one value for each timestep up to {t}, found {len(prior_variance)}")
        return float(prior_variance[t])
    return prior_variance * (1 - alpha_bar) / (prior_variance * alpha_bar + 1 - alpha_bar)


@torch.no_grad()
def measure_variance(
    denoise: Denoise, schedule: NoiseSchedule, clean: Tensor, timesteps: Sequence[int], seed: int = 0
) -> Tensor:
    """A table (T,) float64 of r_t^2: the mean squared error of the estimate of x_0 = ``clean`` (N, C, H, W).

    ``denoise`` is bound to the conditions of ``clean``, which it was not trained on. The error is measured at ``timesteps``
    (one evaluation each) and interpolated between them, log r_t^2 linear in log sigma_t, constant beyond the ends.
    """
    generator = torch.Generator().manual_seed(seed)
    errors = []
    for t in sorted(timesteps):
        level = float(schedule.alpha_bar[t])
        noise = torch.randn(clean.shape, generator=generator).to(clean)
        estimate = denoise(level**0.5 * clean + (1 - level) ** 0.5 * noise, t)
        errors.append(float((estimate - clean).double().square().mean()))
    # the smallest normal number stands in for no signal at all (zero terminal SNR), whose log sigma is infinite
    tiny = np.finfo(np.float64).tiny
    log_sigma = np.log((1 - schedule.alpha_bar.numpy()) / np.maximum(schedule.alpha_bar.numpy(), tiny)) / 2
    log_error = np.interp(log_sigma, log_sigma[sorted(timesteps)], np.log(np.maximum(errors, tiny)))
    return torch.from_numpy(np.exp(log_error))
