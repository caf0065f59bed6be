"""The metallic texture in a whole fit: recovered where the plan asks for it, absent where it does not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from small_fit import Record, altered, fit, make_problem, same

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings, LearningRates
from ia_bench.priors.none import NoPrior
from ia_bench.scenes.scene import Scene

SETTINGS = FitSettings(stage1_steps=150, stage2_steps=50, pixels=1024, roughness_start=0.1)


@pytest.fixture(scope="module")
def half_metal(tiny: Scene) -> tuple[Problem, Material]:
    """Scene tiny with a golden metal on one half of the atlas, rendered by our renderer."""
    assert tiny.truth is not None
    problem = make_problem(tiny)
    albedo = torch.from_numpy(tiny.truth.albedo).float().clone()
    metallic = torch.zeros(*albedo.shape[:2], 1)
    metallic[:, : albedo.shape[1] // 2] = 1
    albedo = torch.where(metallic > 0, torch.tensor([0.9, 0.6, 0.25]), albedo)
    material = Material(albedo, torch.full((4, 4, 1), 0.3), metallic)
    light = SampledLight.of(LatLongEnvironment(torch.from_numpy(tiny.truth.lights["studio"])).latlong(16))
    images = problem.renderer.render_images(problem.gbuffer, material, light, 256, torch.Generator().manual_seed(1))
    views = tuple(
        replace(view, image=image, mask=mask)
        for view, image, mask in zip(tiny.train, images["radiance"].numpy(), problem.gbuffer.coverage().numpy(), strict=True)
    )
    return altered(problem, scene=replace(tiny.blind(), train=views)), material


def test_metal_is_told_from_paint(half_metal: tuple[Problem, Material]) -> None:
    """From one start for all, the metal half ends at least 0.3 above the painted one, and the fit is better than without."""
    problem, truth = half_metal
    assert truth.metallic is not None
    with_metal, without = Record(), Record()
    found = fit(altered(problem, plan=replace(problem.plan, metallic=True)), NoPrior(), SETTINGS, with_metal).material
    assert found.metallic is not None
    assert fit(problem, NoPrior(), SETTINGS, without).material.metallic is None
    hit = problem.gbuffer.face >= 0
    uv = problem.renderer.surface.uv(problem.gbuffer.face[hit].long(), problem.gbuffer.barycentric[hit])
    metal = fetch(truth.metallic, uv)[:, 0] > 0.5
    guess = fetch(found.metallic, uv)[:, 0]
    assert float(guess[metal].mean()) > float(guess[~metal].mean()) + 0.3
    assert sum(with_metal.losses[-20:]) < 0.9 * sum(without.losses[-20:])


def test_it_resumes_to_the_same_bits(half_metal: tuple[Problem, Material]) -> None:
    problem = altered(half_metal[0], plan=replace(half_metal[0].plan, metallic=True))
    settings = replace(SETTINGS, stage1_steps=8, stage2_steps=4, pixels=128, rates=LearningRates(metallic=0.1))
    whole = Record(every=0.0)
    uninterrupted = fit(problem, NoPrior(), settings, whole)
    resumed = fit(problem, NoPrior(), settings, Record(), resume=whole.states[6])
    assert same(uninterrupted, resumed)
    assert resumed.material.metallic is not None
    assert torch.equal(resumed.material.metallic, uninterrupted.material.metallic)
