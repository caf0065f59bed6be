"""Schedules against their formulas and diffusers' own timesteps; conversions against the definition of x_t."""

from __future__ import annotations

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.schedule import NoiseSchedule, image_behind

SIGMAS = [1e-4, 1e-2, 1.0, 1e2, 1e4]


@pytest.mark.parametrize("sigma", SIGMAS)
def test_the_noise_tells_the_image(sigma: float):
    x0, noise = torch.randn(2, 4, 3, 5, 7, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    level = 1 / (1 + sigma**2)
    noisy = (level**0.5 * x0 + (1 - level) ** 0.5 * noise).float()
    found = image_behind(noise.float(), noisy, level).double()
    assert float((found - x0).abs().max()) < 1e-6 * (1 + sigma)  # a few units in the last place, magnified by the division


def test_diffusers_config():
    config = {"num_train_timesteps": 1000, "beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear"}
    betas = torch.linspace(0.00085**0.5, 0.012**0.5, 1000, dtype=torch.float64).square()
    expected = (1 - betas).cumprod(0)
    torch.testing.assert_close(NoiseSchedule.from_diffusers(config).alpha_bar, expected, rtol=1e-4, atol=0)

    schedule = NoiseSchedule.from_diffusers({**config, "rescale_betas_zero_snr": True})
    root = expected.sqrt()  # Lin et al. 2024, algorithm 1
    root = (root - root[-1]) * root[0] / (root[0] - root[-1])
    assert schedule.alpha_bar[-1] == 0
    torch.testing.assert_close(schedule.alpha_bar, root.square(), rtol=1e-3, atol=1e-6)
    with pytest.raises(InputError, match="scheduler config"):
        NoiseSchedule.from_diffusers({**config, "beta_schedule": "straight"})


@pytest.mark.parametrize("spacing", ["trailing", "leading"])
def test_timesteps_are_those_of_diffusers(spacing: str):
    from ia_bench.common.torchvision_shim import import_torchvision

    import_torchvision()
    from diffusers import DDIMScheduler

    schedule = NoiseSchedule(torch.linspace(0.99, 0.01, 1000))
    for steps in (1, 7, 10, 50, 333):
        scheduler = DDIMScheduler(timestep_spacing=spacing, steps_offset=1)
        scheduler.set_timesteps(steps)
        assert schedule.timesteps(steps, spacing) == scheduler.timesteps.tolist()


@pytest.mark.parametrize("spacing", ["trailing", "leading"])
def test_any_number_of_steps(spacing: str):
    for length in (1, 2, 37, 100):
        schedule = NoiseSchedule(torch.linspace(0.99, 0.01, length))
        for steps in range(1, length + 1):
            chosen = schedule.timesteps(steps, spacing)
            assert len(chosen) == steps
            assert all(a > b for a, b in zip(chosen, chosen[1:], strict=False))
            assert 0 <= chosen[-1] <= chosen[0] < length
            assert spacing == "leading" or chosen[0] == length - 1


@pytest.mark.parametrize("steps", [0, -1, 11])
def test_too_many_or_too_few_steps(steps: int):
    with pytest.raises(InputError, match="1 ... 10"):
        NoiseSchedule(torch.linspace(0.99, 0.01, 10)).timesteps(steps)


@pytest.mark.parametrize("levels", [[], [[0.5]], [0.5, 0.5], [0.4, 0.5], [1.0, 0.5], [0.5, -0.1], [0.5, float("nan")]])
def test_no_schedule(levels: list):
    with pytest.raises(InputError, match="noise schedule"):
        NoiseSchedule(torch.tensor(levels))
