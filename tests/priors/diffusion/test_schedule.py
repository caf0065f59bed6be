"""Schedules against their formulas and diffusers' own timesteps; conversions against the definition of x_t."""

from __future__ import annotations

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.schedule import NoiseSchedule, estimate_x0, ideal_output

SIGMAS = [1e-4, 1e-2, 1.0, 1e2, 1e4]


def test_from_sigmas_keeps_the_noise_to_signal_ratio():
    level = NoiseSchedule.from_sigmas(SIGMAS).alpha_bar
    torch.testing.assert_close((1 / level - 1).sqrt(), torch.tensor(SIGMAS, dtype=torch.float64), rtol=1e-7, atol=0)


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("prediction_type", ["epsilon", "v_prediction", "sample"])
def test_raw_outputs_become_the_image(prediction_type: str, sigma: float):
    x0, noise = torch.randn(2, 4, 3, 5, 7, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    level = 1 / (1 + sigma**2)
    signal, spread = level**0.5, (1 - level) ** 0.5
    output = {"epsilon": noise, "v_prediction": signal * noise - spread * x0, "sample": x0}[prediction_type]
    assert torch.allclose(ideal_output(prediction_type, x0, noise, level), output, rtol=0, atol=1e-12)
    raw, noisy = output.float(), (signal * x0 + spread * noise).float()
    rounding = 1e-6  # a few units in the last place, magnified where the definition itself divides
    found = estimate_x0(prediction_type, raw, noisy, level).double()
    assert float((found - x0).abs().max()) < rounding * (1 + sigma if prediction_type == "epsilon" else 1)


@pytest.mark.parametrize("prediction_type", ["v_prediction", "sample"])
def test_pure_noise_has_an_image_estimate(prediction_type: str):
    output, noisy = torch.full((1, 1, 2, 2), 0.5), torch.ones(1, 1, 2, 2)
    expected = {"v_prediction": -output, "sample": output}[prediction_type]
    assert torch.equal(estimate_x0(prediction_type, output, noisy, 0.0), expected)


def test_levels_of_a_batch():
    output, noisy = torch.randn(2, 3, 1, 2, 2, generator=torch.Generator().manual_seed(1))
    levels = torch.tensor([0.1, 0.5, 0.99], dtype=torch.float64)
    for convert in (estimate_x0, ideal_output):
        together = convert("v_prediction", output, noisy, levels[:, None, None, None])
        for i, level in enumerate(levels.tolist()):
            assert torch.equal(together[i], convert("v_prediction", output[i], noisy[i], level))


def test_diffusers_config():
    config = {"num_train_timesteps": 1000, "beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear"}
    betas = torch.linspace(0.00085**0.5, 0.012**0.5, 1000, dtype=torch.float64).square()
    expected = (1 - betas).cumprod(0)
    torch.testing.assert_close(NoiseSchedule.from_diffusers(config).alpha_bar, expected, rtol=1e-4, atol=0)

    rescaled = {**config, "rescale_betas_zero_snr": True}
    schedule = NoiseSchedule.from_diffusers({**rescaled, "prediction_type": "v_prediction"})
    root = expected.sqrt()  # Lin et al. 2024, algorithm 1
    root = (root - root[-1]) * root[0] / (root[0] - root[-1])
    assert schedule.alpha_bar[-1] == 0
    torch.testing.assert_close(schedule.alpha_bar, root.square(), rtol=1e-3, atol=1e-6)
    with pytest.raises(InputError, match="zero terminal SNR"):
        NoiseSchedule.from_diffusers(rescaled)
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


def test_unknown_names():
    schedule, image = NoiseSchedule(torch.tensor([0.5])), torch.zeros(1)
    for call in (
        lambda: schedule.require("noise"),
        lambda: schedule.timesteps(1, "linear"),
        lambda: estimate_x0("noise", image, image, 0.5),
        lambda: ideal_output("noise", image, image, 0.5),
    ):
        with pytest.raises(InputError, match="expected one of"):
            call()
