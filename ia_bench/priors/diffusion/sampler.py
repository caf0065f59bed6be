"""DDIM and ancestral sampling of a diffusion model, plain or guided; each image is a function of its own seed alone.

The sampler knows no network. It asks a :data:`Denoise` for the estimate of x_0; conditions, the meaning of a raw output and
the count of evaluations belong to whoever makes that function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.guidance import Guidance
from ia_bench.priors.diffusion.schedule import Denoise, NoiseSchedule, Spacing

Noise = Callable[[], Tensor]
"""Standard normal noise (N, C, H, W), fresh at every call: the start first, then that of each step that takes any."""


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
    guidance: Guidance | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Draw ``shape`` (N, C, H, W) samples in the network's space; ``seeds``: one per image, or where their noise comes from.

    Each step replaces x_t by (Song et al. 2021, "Denoising diffusion implicit models", equation 12, with eps eliminated)

        x_s = sqrt(alpha_bar_s) x_0 + sqrt(1 - alpha_bar_s - f^2) (x_t - sqrt(alpha_bar_t) x_0) / sqrt(1 - alpha_bar_t) + f z
        f^2 = eta^2 (1 - alpha_bar_s) / (1 - alpha_bar_t) (1 - alpha_bar_t / alpha_bar_s),   z ~ N(0, I)

    where x_0 is the estimate, guided and clipped. The last step has alpha_bar_s = 1 and returns x_0 itself.

    An image's start and the noise of its steps come from one generator of its own on the CPU, so its sample depends on its
    seed (and its condition) alone: neither on the batch nor on the device. ``guidance`` None or of strength 0 gives the
    same bits. ``denoise`` runs without gradients unless the guidance rule needs them, and is called ``settings.steps`` times.
    Raises InputError where sizes do not match.
    """
    noise = seeds if callable(seeds) else seeded_noise(seeds, shape[1:])
    if not callable(seeds) and len(seeds) != shape[0]:
        raise InputError(f"seeds: expected one per image ({shape[0]}), found {len(seeds)}")
    if guidance is not None and not guidance.active:
        guidance = None
    if guidance is not None and tuple(guidance.target.shape) != tuple(shape):
        raise InputError(f"guidance target: expected shape {tuple(shape)}, found {tuple(guidance.target.shape)}")
    noisy = noise().to(device, dtype)
    timesteps = schedule.timesteps(settings.steps, settings.spacing)
    levels = [float(schedule.alpha_bar[t]) for t in timesteps] + [1.0]
    for t, level, following in zip(timesteps, levels[:-1], levels[1:], strict=True):
        x0 = denoise(noisy, t) if guidance is None else guidance.estimate_x0(denoise, noisy, t, level)
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
