"""The joint step of light and albedo: its gradient, what it leaves alone, and that it finds a cast that Adam alone does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import TEXELS_ALONE, Record, altered, fit
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.steps import MAX_WHITE, ScaleAmbiguityStep
from ia_bench.priors.none import NoPrior
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene

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
    loss_of(albedo, log_light, images).backward()
    step = 1e-6
    slopes = []
    for channel in range(3):
        c = torch.zeros(3, dtype=torch.float64)
        c[channel] = step
        with torch.no_grad():
            up, down = (loss_of(albedo * torch.exp(-s * c), log_light + s * c, images) for s in (1, -1))
        slopes.append((up - down) / (2 * step))
    torch.testing.assert_close(
        ScaleAmbiguityStep(albedo, log_light, OBSERVED).gradient(), torch.stack(slopes), rtol=1e-6, atol=1e-12
    )


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
    exchange = ScaleAmbiguityStep(albedo, log_light, OBSERVED)
    exchange(0.05)
    torch.testing.assert_close(albedo.detach(), start)
    assert exchange.blocked == 1
    again = ScaleAmbiguityStep(albedo, log_light, OBSERVED)
    again.load_state_dict(exchange.state_dict())
    assert again.blocked == 1
    unseen = OBSERVED.clone()
    unseen[0] = False
    ScaleAmbiguityStep(albedo, log_light, unseen)(0.05)
    torch.testing.assert_close(albedo.detach(), start * torch.exp(torch.tensor(0.05)))


def test_nothing_observed_is_no_failure() -> None:
    albedo, log_light, images = tensors()
    albedo.requires_grad_(), log_light.requires_grad_()
    loss_of(albedo, log_light, images).backward()
    ScaleAmbiguityStep(albedo, log_light, ~OBSERVED)(0.05)
    assert bool(torch.isfinite(albedo).all() & torch.isfinite(log_light).all())


def test_a_fit_gets_the_level_of_the_albedo_right(problem: Problem, scene: Scene) -> None:
    """Images of our own renderer, so that nothing but the start is wrong: no alignment, no prior, a coloured light."""
    assert scene.truth is not None
    truth = Material(torch.from_numpy(scene.truth.albedo).float(), torch.from_numpy(scene.truth.roughness).float()[..., None])
    light = SampledLight.of(LatLongEnvironment(torch.from_numpy(scene.truth.lights["sunset"])).latlong(16))
    images = problem.renderer.render_images(problem.gbuffer, truth, light, 256, torch.Generator().manual_seed(1))
    coverage = problem.gbuffer.coverage().numpy()
    views = tuple(
        replace(view, image=image, mask=mask)
        for view, image, mask in zip(problem.scene.train, images["radiance"].numpy(), coverage, strict=True)
    )
    problem = altered(problem, scene=replace(problem.scene, train=views), plan=replace(problem.plan, samples=32))
    settings = FitSettings(stage1_steps=400, stage2_steps=0, pixels=1024, multigrid_rates=TEXELS_ALONE)
    inside = coverage > 0.99
    wanted = images["albedo"].numpy()[inside].mean(0)
    off = {}
    for rate in (0.0, 0.05):
        one = fit(problem, NoPrior(), replace(settings, rates=replace(settings.rates, scale_ambiguity=rate)), Record())
        picture = texture_images(problem.renderer.surface, problem.gbuffer, one.material.albedo).numpy()[inside]
        off[rate] = float(np.abs(np.log(picture.mean(0) / wanted)).max())
    assert off[0.05] < 0.2 < 0.3 < off[0.0]


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
@pytest.mark.parametrize("key", ["rates.scale_ambiguity", "scale_ambiguity_start"])
def test_settings_that_cannot_be_meant_are_refused(key: str, value: float) -> None:
    group, _, name = key.rpartition(".")
    with pytest.raises(InputError, match=f"fit.{key}: expected .*, found"):
        parsed(FitSettings, {group: {name: value}} if group else {name: value}, "fit")
