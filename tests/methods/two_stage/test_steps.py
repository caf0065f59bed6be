"""The steps beside those of single texels: at coarser scales, along the scale ambiguity; and exposures."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, altered
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.steps import MAX_WHITE, MultigridSteps, ScaleAmbiguityStep

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


def test_a_light_has_no_seam() -> None:
    """Of a lat-long map it does not matter which column is the first one; of a texture it does."""
    gradient, moved = torch.randn(16, 32, 3, generator=torch.Generator().manual_seed(0)), []
    for columns in (0, 8):
        image = torch.zeros(16, 32, 3, requires_grad=True)
        MultigridSteps({"light": image}, BETAS, wrapped=["light"])({"light": 0.1}, {"light": gradient.roll(columns, 1)})
        moved.append(image.detach().roll(-columns, 1))
    torch.testing.assert_close(*moved)


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


OBSERVED = torch.ones(16, 16, dtype=torch.bool)


def render(albedo: Tensor, log_light: Tensor) -> Tensor:
    """Eight views (8, 16, 16, 3) of a glossy plane in closed form: a diffuse part, and a mirror image of half of the light each."""
    light = torch.exp(log_light)
    mirrored = torch.cat([light.roll(shift, (0, 1)).reshape(2, *albedo.shape) for shift in ((0, 0), (3, 5), (7, 2), (11, 9))])
    return albedo * light.mean((0, 1)) + 0.05 * mirrored


def loss_of(albedo: Tensor, log_light: Tensor, images: Tensor) -> Tensor:
    return (render(albedo, log_light) - images).abs().mean()


def tensors() -> tuple[Tensor, Tensor, Tensor]:
    """Albedo (16, 16, 3) up to 0.6, log radiance (16, 32, 3) over four units, and the images of both."""
    random = torch.Generator().manual_seed(0)
    albedo = 0.1 + 0.5 * torch.rand(16, 16, 3, generator=random)
    log_light = 4 * torch.rand(16, 32, 3, generator=random)
    return albedo, log_light, render(albedo, log_light)


def test_gradient_is_that_of_the_factor() -> None:
    albedo, log_light, images = (tensor.double() for tensor in tensors())
    albedo, log_light = (1.1 * albedo).requires_grad_(), (log_light - 0.2).requires_grad_()
    c = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(loss_of(albedo * torch.exp(-c), log_light + c, images), c)
    loss_of(albedo, log_light, images).backward()
    torch.testing.assert_close(ScaleAmbiguityStep(albedo, log_light, OBSERVED).gradient(), slope)


def test_diffuse_images_stay_as_they_are() -> None:
    albedo, log_light, images = tensors()
    albedo.requires_grad_(), log_light.requires_grad_()
    loss_of(albedo, log_light, 0.5 * images).backward()
    before = (albedo * torch.exp(log_light).mean((0, 1))).detach().clone()
    start = log_light.detach().clone()
    ScaleAmbiguityStep(albedo, log_light, OBSERVED)(0.05)
    moved = (log_light.detach() - start).reshape(-1, 3)
    torch.testing.assert_close(moved, moved[:1].expand_as(moved), rtol=0, atol=1e-6)
    torch.testing.assert_close(moved[0].abs(), torch.full((3,), 0.05), rtol=1e-4, atol=0)  # Adam's first step is its rate
    torch.testing.assert_close((albedo * torch.exp(log_light).mean((0, 1))).detach(), before)


def test_it_finds_the_cast_that_rates_of_their_own_do_not() -> None:
    """Start: the truth under a cast of (1.5, 1, 0.7), whose diffuse part is already right."""
    left = {}
    for rate in (0.0, 0.05):
        true_albedo, true_light, images = tensors()
        wrong = torch.log(torch.tensor([1.5, 1.0, 0.7]))
        albedo, log_light = (true_albedo * torch.exp(-wrong)).requires_grad_(), (true_light + wrong).requires_grad_()
        optimizer = torch.optim.Adam([{"params": [albedo], "lr": 0.01}, {"params": [log_light], "lr": 0.05}], betas=(0.9, 0.99))
        exchange = ScaleAmbiguityStep(albedo, log_light, OBSERVED)
        for step in range(300):
            decay = 0.05 ** (step / 299)
            optimizer.zero_grad()
            loss_of(albedo, log_light, images).backward()
            if rate:
                exchange(rate * decay)
            for group, base in zip(optimizer.param_groups, (0.01, 0.05), strict=True):
                group["lr"] = base * decay
            optimizer.step()
        left[rate] = float(torch.log(albedo.detach().mean((0, 1)) / true_albedo.mean((0, 1))).abs().max())
    assert left[0.05] < 0.06
    assert left[0.05] < 0.3 * left[0.0]


def test_white_texels_are_not_pushed_further() -> None:
    albedo, log_light, images = tensors()
    albedo[0] = 1.0  # 16 of 256 texels, more than MAX_WHITE of them
    assert MAX_WHITE < 16 / 256
    albedo.requires_grad_(), log_light.requires_grad_()
    (loss_of(albedo, log_light, images) + 10 * log_light.sum()).backward()  # darker light, brighter paint
    start = albedo.detach().clone()
    assert ScaleAmbiguityStep(albedo, log_light, OBSERVED)(0.05)
    torch.testing.assert_close(albedo.detach(), start)
    unseen = OBSERVED.clone()
    unseen[0] = False
    assert not ScaleAmbiguityStep(albedo, log_light, unseen)(0.05)
    torch.testing.assert_close(albedo.detach(), start * torch.exp(torch.tensor(0.05)))


@pytest.mark.parametrize("channels", [1, 3])
def test_exposures_that_the_images_tell(problem: Problem, channels: int) -> None:
    """The same light photographed at 1/2 to 2 of it; factors are told up to their mean, and a step that is skipped moves none."""
    scene = replace(problem.scene, exposures_differ=True, white_balances_differ=channels == 3)
    parameters = Parameters(altered(problem, scene=scene), SETTINGS)
    views = len(parameters.exposures)
    parameters.exposures.sum().backward()
    parameters.clear()  # as the next step begins
    parameters.descend(0, 1000)
    assert parameters.exposures.tolist() == [[1] * channels] * views
    true = (torch.linspace(-0.7, 0.7, views)[:, None] * torch.tensor([1.0, -0.5, 0.2])[:channels]).exp()
    for step in range(300):
        parameters.clear()
        (parameters.exposures * 0.7 - 0.7 * true).abs().mean().backward()
        parameters.descend(step, 1000)
        assert float(parameters.tensors["log_exposure"].detach().sum(0).abs().max()) < 1e-5
    torch.testing.assert_close(parameters.exposures.detach(), true, rtol=0.05, atol=0)
