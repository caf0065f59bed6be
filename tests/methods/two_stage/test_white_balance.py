"""Photographs whose channels were multiplied by factors that the test knows: what a fit finds of them, and of the albedo."""

from dataclasses import replace

import pytest
import torch
from small_fit import TEXELS_ALONE, albedo_error, altered, losses_of
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.monitor import Monitor
from ia_bench.methods.two_stage.fit import TwoStageFit
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.settings import FitSettings, LearningRates
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="module")
def factors(scene: Scene) -> Tensor:
    """Three of each photograph, from .64 to 1.74; of each channel the geometric mean is 1."""
    logarithms = 0.25 * torch.randn(len(scene.train), 3, generator=torch.Generator().manual_seed(3))
    return (logarithms - logarithms.mean(0)).exp()


def multiplied(problem: Problem, images: Tensor, factors: Tensor) -> Problem:
    """The problem with ``images`` times the factors for photographs, and told that white balances differ."""
    coloured = (images * factors[:, None, None]).numpy()
    train = tuple(replace(view, image=image) for view, image in zip(problem.scene.train, coloured, strict=True))
    return altered(problem, scene=replace(problem.scene, train=train, exposures_differ=True, white_balances_differ=True))


def test_factors_of_known_material_and_light(scene: Scene, problem: Problem, factors: Tensor) -> None:
    """Photographs of our renderer; textures and light stay true, so that the factors are all there is to find.

    Adam's last steps are of .02 x .05 = .1 % each, and the noise of 512 pixels' samples lets a factor wander some of them.
    """
    still = LearningRates(albedo=0.0, roughness=0.0, light=0.0, scale_ambiguity=0.0)
    settings = FitSettings(stage1_steps=200, stage2_steps=0, pixels=512, rates=still, multigrid_rates=TEXELS_ALONE)
    albedo = torch.from_numpy(scene.truth.albedo)[::2, ::2]
    light = LatLongEnvironment(torch.from_numpy(scene.truth.lights["train"])).latlong(16).clamp_min(1e-4)
    material = Material(albedo.contiguous(), torch.full((64, 64, 1), settings.roughness_initial))
    random = torch.Generator().manual_seed(1)
    images = problem.renderer.render_images(problem.gbuffer, material, SampledLight.of(light), 256, random)["radiance"]
    asked = multiplied(problem, images, factors)
    parameters, losses = Parameters(asked, settings), losses_of(asked, settings)
    with torch.no_grad():
        parameters.tensors["albedo"].copy_(material.albedo)
        parameters.tensors["log_light"].copy_(light.log())
    for step in range(200):
        pixels = torch.randint(len(asked.gbuffer.pixel), (512,), generator=random)
        parameters.clear()
        losses(pixels, parameters, step, 200, random)[0]["image"].backward()
        parameters.descend(step, 200)
    found = parameters.exposures.detach()
    torch.testing.assert_close(found, factors, rtol=0.02, atol=0)
    torch.testing.assert_close(found.log().mean(0), torch.zeros(3), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_fit_finds_factors_and_the_albedo_beside_them(scene: Scene, problem: Problem, factors: Tensor) -> None:
    """Of the scene's own photographs, by all of a short fit: its albedo is about that of photographs without factors.

    Factors end 3 % off in the mean where there are none, for the fit is short; without them the albedo is off by a fifth more.
    """
    settings = FitSettings(stage1_steps=150, stage2_steps=0, pixels=1024)
    images = torch.stack([torch.from_numpy(view.image) for view in problem.scene.train])
    coloured = multiplied(problem, images, factors)
    unaware = altered(coloured, scene=replace(coloured.scene, exposures_differ=False, white_balances_differ=False))
    errors = []
    for asked in (problem, coloured, unaware):
        fit = TwoStageFit(asked, settings, 0, Monitor.silent())
        fit.descent.descend()
        errors.append(albedo_error(problem, scene, fit.parameters.material(detached=True).albedo))
        if asked is coloured:
            off = (fit.parameters.exposures.detach() / factors).log().abs().mean()
    assert float(off) < 0.05  # of factors that are .15 off 1 in the mean
    assert errors[1] < 1.1 * errors[0]
    assert errors[2] > 1.15 * errors[0]
