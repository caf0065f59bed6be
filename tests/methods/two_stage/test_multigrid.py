"""Steps at coarser scales: what they add up to, by sums in float64; what they leave alone; and that they find what is smooth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.steps import MultigridSteps

BETAS = 0.9, 0.99
STEP, STEPS = 6, 30


def doubled(image: np.ndarray) -> np.ndarray:
    """Bilinear by its definition: a texel's centre lies a quarter of a coarse texel beside the nearest coarse centre."""
    for axis in (0, 1):
        side = image.shape[axis]
        nearest = np.arange(2 * side) // 2
        other = (nearest + np.where(np.arange(2 * side) % 2, 1, -1)).clip(0, side - 1)
        image = 0.75 * image.take(nearest, axis) + 0.25 * image.take(other, axis)
    return image


def expected_move(gradients: list[np.ndarray], factor: int, rate: float) -> np.ndarray:
    """What Adam makes of the sums over blocks of ``factor`` x ``factor`` texels, brought back to the texels."""
    first = second = moved = np.zeros(())
    for step, gradient in enumerate(gradients, 1):
        height, width, channels = gradient.shape
        total = gradient.reshape(height // factor, factor, width // factor, factor, channels).sum((1, 3))
        first, second = BETAS[0] * first + (1 - BETAS[0]) * total, BETAS[1] * second + (1 - BETAS[1]) * total**2
        corrected = np.sqrt(second / (1 - BETAS[1] ** step)) + 1e-8
        moved = moved - rate * first / (1 - BETAS[0] ** step) / corrected
    for _ in range(int(math.log2(factor))):
        moved = doubled(moved)
    return moved


def test_steps_add_up_to_those_of_every_level() -> None:
    """Against Adam and bilinear interpolation in numpy's float64; 24 x 48 texels have levels of 12 and 6 rows, and none of 3."""
    random = np.random.default_rng(0)
    start = random.random((24, 48, 3))
    gradients = [random.normal(size=start.shape) for _ in range(4)]
    image = torch.from_numpy(start).float().requires_grad_()
    steps = MultigridSteps({"light": image}, BETAS)
    for gradient in gradients:
        steps({"light": 0.1}, {"light": torch.from_numpy(gradient).float()})
    expected = start + sum(expected_move(gradients, factor, 0.1) for factor in (2, 4))
    np.testing.assert_allclose(image.detach().numpy(), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("rates", [{}, {"still": 0.0}])
def test_what_has_no_rate_or_no_gradient_stays(rates: dict[str, float]) -> None:
    still, moved, frozen = (torch.ones(16, 16, 1, requires_grad=True) for _ in range(3))
    steps = MultigridSteps({"still": still, "moved": moved, "frozen": frozen}, BETAS)
    steps({**rates, "moved": 0.1, "frozen": 0.1}, {"still": torch.ones(16, 16, 1), "moved": torch.ones(16, 16, 1), "frozen": None})
    assert torch.equal(still, torch.ones_like(still))
    assert torch.equal(frozen, torch.ones_like(frozen))
    torch.testing.assert_close(moved, torch.full_like(moved, 1 - 2 * 0.1))  # Adam's first step is its rate, at 8 and 4 rows


@pytest.mark.parametrize("shape", [(7, 14, 3), (4, 8, 3), (6, 12, 1)])
def test_an_image_without_coarser_levels_is_left_alone(shape: tuple[int, int, int]) -> None:
    image = torch.ones(shape, requires_grad=True)
    steps = MultigridSteps({"light": image}, BETAS)
    steps({"light": 0.1}, {"light": torch.ones(shape)})
    assert torch.equal(image, torch.ones(shape))
    steps.load_state_dict(steps.state_dict())
    assert steps.state_dict() == {}


def test_its_state_goes_on_where_it_was() -> None:
    random = torch.Generator().manual_seed(0)
    gradients = torch.randn(6, 16, 16, 3, generator=random)
    ends = []
    for stop in (None, 3):
        image = torch.zeros(16, 16, 3, requires_grad=True)
        steps = MultigridSteps({"albedo": image}, BETAS)
        for step, gradient in enumerate(gradients):
            if step == stop:
                state, steps = steps.state_dict(), MultigridSteps({"albedo": image}, BETAS)
                steps.load_state_dict(state)
            steps({"albedo": 0.05}, {"albedo": gradient})
        ends.append(image.detach().clone())
    assert torch.equal(*ends)


def distance_left(coarse: float, steps: int = 60) -> float:
    """Root mean square distance from a smooth image of 64 x 64 texels, of which each step has a noisy glance at 2 %.

    Of means over 8 x 8 texels: the noise that steps of single texels leave behind is the same with and without coarser ones.
    """
    random = torch.Generator().manual_seed(0)
    line = torch.linspace(0, 2 * math.pi, 64)
    wanted = (0.5 + 0.2 * torch.sin(line)[:, None] * torch.cos(line))[..., None]
    image = torch.full((64, 64, 1), 0.5, requires_grad=True)
    adam, beside = torch.optim.Adam([image], betas=BETAS), MultigridSteps({"albedo": image}, BETAS)

    def glance() -> Tensor:
        seen = torch.rand(wanted.shape, generator=random) < 0.02
        return seen * (image.detach() - wanted + 0.2 * torch.randn(wanted.shape, generator=random))

    for step in range(steps):
        fall = 0.05 ** (step / steps)
        image.grad = gradient = glance()
        adam.param_groups[0]["lr"] = 0.03 * fall
        adam.step()
        beside({"albedo": coarse * fall}, {"albedo": gradient})
    off = (image.detach() - wanted)[..., 0].reshape(8, 8, 8, 8).mean((1, 3))
    return float(off.square().mean().sqrt())


def test_they_find_a_smooth_image_that_single_texels_do_not() -> None:
    assert distance_left(0.02) < 0.5 * distance_left(0.0)


def test_a_loss_of_single_texels_moves_nothing_at_coarser_scales(problem: Problem) -> None:
    """The first step of Adam is its rate: alone that of texels, else those of all scales together."""
    settings, moved = FitSettings(), {}
    for alone in (True, False):
        parameters = Parameters(problem, settings)
        before = parameters.tensors["albedo"].detach().clone()
        texture = parameters.alone("albedo") if alone else parameters.tensors["albedo"]
        (texture.sum() + parameters.tensors["log_light"].sum() * 0).backward()
        assert float(parameters.gradients["albedo"].mean()) == 1
        parameters.descend(STEP, STEPS)  # albedo moves, roughness and the exchange do not yet
        moved[alone] = before - parameters.tensors["albedo"].detach()
        parameters.clear()
        assert parameters.gradients == {}
    fall = settings.rates.final ** (STEP / (STEPS - 1))
    torch.testing.assert_close(moved[True], torch.full_like(moved[True], settings.rates.albedo * fall), rtol=1e-3, atol=1e-6)
    assert float(moved[False].mean()) > 2 * float(moved[True].mean())
