"""Steps against Bayes' rule and diffusers; independence of the batch to the bit; a Gaussian's moments."""

from __future__ import annotations

import math

import pytest
import torch
from gaussian_prior import gaussian_denoiser, wide_schedule
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.guidance import Guidance
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample, step_weights
from ia_bench.priors.diffusion.schedule import NoiseSchedule

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
    from ia_bench.common.torchvision_shim import import_torchvision

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


@pytest.mark.parametrize("rule", ["paper", "variance"])
def test_strength_zero_is_the_unguided_sample_to_the_bit(rule: str):
    for steps, eta in ((1, 0.0), (9, 0.0), (9, 1.0)):
        plain = sample(network, COSINE, (2, 2, 5, 7), [1, 2], SamplerSettings(steps, eta))
        guidance = Guidance(torch.ones(2, 2, 5, 7), 0.0, rule=rule)
        assert torch.equal(sample(network, COSINE, (2, 2, 5, 7), [1, 2], SamplerSettings(steps, eta), guidance), plain)


@pytest.mark.parametrize("steps", [1, 2, 10, 100])
@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_any_number_of_steps_stays_in_range_and_calls_once_a_step(steps: int, eta: float):
    calls = []

    def counted(noisy: Tensor, t: int) -> Tensor:
        calls.append(t)
        return 100 * network(noisy, t)

    found = sample(counted, COSINE, (1, 1, 5, 7), [0], SamplerSettings(steps, eta, clip=(-0.5, 1.0)))
    assert calls == COSINE.timesteps(steps)
    assert -0.5 <= float(found.min()) <= float(found.max()) <= 1.0


def test_the_last_step_returns_the_estimate_itself():
    image = torch.rand(2, 3, 5, 7)
    assert torch.equal(sample(lambda noisy, t: image, COSINE, (2, 3, 5, 7), [0, 1], SamplerSettings(5, 1.0)), image)


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_moments_of_a_gaussian(eta: float):
    """4.5 standard errors: false alarm 7e-6 a number, four numbers in all; the discretisation takes up to 0.5 % of the variance."""
    schedule, shape = wide_schedule(1000), (4, 3, 64, 64)
    count = math.prod(shape)
    found = sample(gaussian_denoiser(schedule, 0.2, 0.09), schedule, shape, range(4), SamplerSettings(1000, eta, clip=None))
    assert abs(float(found.mean()) - 0.2) < 4.5 * math.sqrt(0.09 / count)
    assert abs(float(found.var()) / 0.09 - 1) < 4.5 * math.sqrt(2 / count) + 0.005


def test_clear_errors():
    good = (network, COSINE, (2, 1, 3, 3), [0, 1], SamplerSettings(2))
    with pytest.raises(InputError, match="seeds: expected one per image"):
        sample(*good[:3], [0], good[4])
    with pytest.raises(InputError, match="guidance target: expected shape"):
        sample(*good, guidance=Guidance(torch.zeros(2, 1, 4, 3), 1.0))
