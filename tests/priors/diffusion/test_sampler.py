"""Schedules against their formulas and diffusers' timesteps, steps against Bayes' rule and diffusers."""

import math

import pytest
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.sampler import NoiseSchedule, SamplerSettings, image_behind, sample, step_weights

COSINE = NoiseSchedule(torch.cos(torch.linspace(0.01, 1.56, 100, dtype=torch.float64)).square())


def network(noisy: Tensor, t: int) -> Tensor:
    """Some non-linear function of x_t and t, value by value, beyond [-1, 1] too."""
    return 1.5 * torch.sin(3 * noisy + t)


@pytest.mark.parametrize(("level", "following"), [(0.5, 0.9), (1e-8, 3e-8), (0.0, 0.1), (1 - 2e-8, 1 - 1e-8), (0.3, 1.0)])
def test_steps_keep_the_marginals(level: float, following: float):
    for eta in (0.0, 0.3, 1.0):
        keep, fresh = step_weights(level, following, eta)
        assert keep**2 * (1 - level) + fresh**2 == pytest.approx(1 - following, rel=1e-6, abs=1e-16)
    assert step_weights(level, following, 0.0)[1] == 0


def test_ancestral_steps_are_bayes_rule():
    """x_s given x_t and x_0 = 0: precision of N(0, 1 - alpha_bar_s) and of x_t = sqrt(r) x_s + N(0, 1 - r) added up."""
    for level, following in ((0.5, 0.9), (1e-3, 0.4), (1e-8, 3e-8)):
        ratio = level / following
        precision = 1 / (1 - following) + ratio / (1 - ratio)
        keep, fresh = step_weights(level, following, 1.0)
        assert fresh**2 == pytest.approx(1 / precision, rel=1e-6)
        assert keep == pytest.approx(math.sqrt(ratio) / (1 - ratio) / precision, rel=1e-6)


@pytest.mark.parametrize("eta", [0.0, 0.7, 1.0])
def test_against_diffusers(eta: float):
    import_torchvision()
    from diffusers import DDIMScheduler

    scheduler = DDIMScheduler(clip_sample=False, prediction_type="sample", timestep_spacing="trailing")
    schedule = NoiseSchedule(scheduler.alphas_cumprod)
    shape, steps = (2, 3, 5, 4), 10  # a divisor of 1000: diffusers steps by floor(1000 / steps) whatever its next timestep is
    noises = [torch.randn(shape, generator=torch.Generator().manual_seed(i)) for i in range(steps + 1)]

    scheduler.set_timesteps(steps)
    expected = noises[0]
    for t, noise in zip(scheduler.timesteps, noises[1:], strict=True):
        expected = scheduler.step(network(expected, int(t)), t, expected, eta=eta, variance_noise=noise).prev_sample

    sequence = iter(noises)
    found = sample(network, schedule, shape, lambda: next(sequence), SamplerSettings(steps, eta, clip=None))
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)  # ten steps through a function of slope 4.5


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_a_sample_depends_on_its_seed_alone(eta: float):
    settings = SamplerSettings(9, eta)
    together = sample(network, COSINE, (3, 2, 5, 7), [4, 0, 123456789012], settings)
    for i, seed in enumerate([4, 0, 123456789012]):
        assert torch.equal(together[i : i + 1], sample(network, COSINE, (1, 2, 5, 7), [seed], settings))
    assert not torch.equal(together[0], together[1])


# ----- the schedule ----------------------------------------------------------------------------------------------------
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
    import_torchvision()
    from diffusers import DDIMScheduler

    schedule = NoiseSchedule(torch.linspace(0.99, 0.01, 1000))
    for steps in (1, 7, 10, 50, 333):
        scheduler = DDIMScheduler(timestep_spacing=spacing, steps_offset=1)
        scheduler.set_timesteps(steps)
        assert schedule.timesteps(steps, spacing) == scheduler.timesteps.tolist()


@pytest.mark.parametrize("levels", [[], [[0.5]], [0.5, 0.5], [0.4, 0.5], [1.0, 0.5], [0.5, -0.1], [0.5, float("nan")]])
def test_no_schedule(levels: list):
    with pytest.raises(InputError, match="noise schedule"):
        NoiseSchedule(torch.tensor(levels))
