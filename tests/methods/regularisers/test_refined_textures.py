"""What a prior corrects in the views of a finished fit reaches its texture, and nothing else of it."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch
from small_fit import SETTINGS, Found, Record, altered, fit, regularised
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.regularisers.fusion import Fusion
from ia_bench.methods.regularisers.refiner import DARK, SAMPLES, evidence, fitted_views
from ia_bench.priors.contract import NoPrior, Observations, PriorInfo, Samples
from ia_bench.priors.refiner import RENDERS
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene

QUICK = replace(SETTINGS, stage1_steps=8, stage2_steps=4)


class Told:
    """Says nothing while a fit runs; corrects its albedo to the truth, at a level of its own, and its roughness to one value."""

    info = PriorInfo(frozenset(), wants=frozenset({"view_count"}))

    def __init__(self, truth: Tensor, level: float = 1.0, roughness: float | None = None) -> None:
        self.truth, self.level, self.roughness = truth, level, roughness
        self.asked: list[tuple[Observations, Mapping[str, Tensor]]] = []

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        return Samples({})

    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        self.asked.append((observations, renders))
        views = list(observations.views)
        rough = {} if self.roughness is None else {"roughness": self.roughness * observations.masks[..., None]}
        return Samples({"albedo": self.level * self.truth[views], **rough}, {}, {"network_calls": len(views)})


def true_views(problem: Problem, scene: Scene) -> tuple[Tensor, Tensor]:
    texture = torch.from_numpy(scene.truth.albedo).float()
    return texture_images(problem.renderer.surface, problem.gbuffer, texture), texture


def refined(problem: Problem, prior: object, albedo: float, roughness: float = 0.0) -> Found:
    settings = regularised(QUICK, refiner={"albedo": albedo, "roughness": roughness})
    return fit(problem, prior, settings, Record())  # type: ignore[arg-type]


def aligned_error(problem: Problem, found: Tensor, truth: Tensor) -> float:
    """Root mean square over wholly covered pixels, one scale for all."""
    images = texture_images(problem.renderer.surface, problem.gbuffer, found)
    inside = problem.gbuffer.coverage() == 1
    a, b = images[inside], truth[inside]
    return float((a * ((a * b).sum() / (a * a).sum()) - b).square().mean().sqrt())


def test_a_prior_that_knows_corrects_the_fit(problem: Problem, scene: Scene) -> None:
    truth, _ = true_views(problem, scene)
    plain, prior = fit(problem, NoPrior(), QUICK, Record()), Told(truth)
    whole, half = refined(problem, prior, 1.0), refined(problem, Told(truth), 0.5)
    errors = [aligned_error(problem, found.material.albedo, truth) for found in (plain, half, whole)]
    assert errors[2] < 0.5 * errors[0]  # no less, for a texel is smaller than a pixel
    assert errors[2] < errors[1] < errors[0]
    assert torch.equal(whole.light, plain.light)
    assert torch.equal(whole.material.roughness, plain.material.roughness)
    assert whole.counters["network_calls"] == 16
    ((observed, renders),) = prior.asked
    assert float(observed.view_count.max()) <= 16
    assert {name: maps.shape[-1] for name, maps in renders.items()} == RENDERS
    shown = texture_images(problem.renderer.surface, problem.gbuffer, plain.material.albedo)
    torch.testing.assert_close(renders["albedo"], shown, atol=2e-2, rtol=0)


@pytest.mark.parametrize(("roughness", "bound"), [(-3.0, 0.03), (4.0, 1.0)])
def test_what_leaves_the_range_is_brought_back_and_counted(problem: Problem, scene: Scene, roughness: float, bound: float) -> None:
    truth, _ = true_views(problem, scene)
    found = refined(problem, Told(truth, roughness=roughness), 0.0, roughness=1.0)
    at_bound = int((found.material.roughness == torch.tensor(bound)).sum())
    assert found.counters["regularisers_clamped"] >= at_bound > 0.9 * found.material.roughness.numel()
    kept = refined(problem, Told(truth, roughness=0.5), 0.0, roughness=1.0)
    assert kept.counters["regularisers_clamped"] == 0


def test_evidence_is_what_all_photographs_say(problem: Problem) -> None:
    """A radiance half as bright as every photograph is off by log 2; a place is as shiny as it is in the mean over views."""
    views = problem.scene.train
    photographs = torch.stack([torch.from_numpy(view.image) for view in views])
    fusion = Fusion(problem, tuple(range(len(views))))
    mean = fusion.pixels(photographs).mean()
    half = (photographs + DARK * mean) / 2 - DARK * mean
    grey = half.mean(-1, keepdim=True)
    specular = (0.2 * (grey + DARK * mean)).expand_as(half)
    off, shine = evidence(fusion, {"radiance": half, "specular": specular}, 64).unbind(-1)
    torch.testing.assert_close(shine, torch.full_like(shine, 0.2), rtol=0.05, atol=0)
    torch.testing.assert_close(off, torch.full_like(off, 0.6931), rtol=0.05, atol=0)
    bounds = tuple(replace(view, valid=torch.zeros(view.mask.shape).bool().numpy()) for view in views)
    bounded = Fusion(altered(problem, scene=replace(problem.scene, train=bounds)), fusion.views)
    assert not evidence(bounded, {"radiance": half, "specular": specular}, 64)[..., 0].any()


def test_a_fit_is_shown_in_the_views_that_are_asked_about(problem: Problem, scene: Scene) -> None:
    """Material by the texture, radiance as the renderer has it, evidence of these photographs alone; RENDERS, all of them."""
    texture = true_views(problem, scene)[1]
    material, light = Material(texture, 0.2 + 0.5 * texture[..., :1]), SampledLight.of(torch.ones(16, 32, 3))
    views, generator = (0, 3, 5), torch.Generator().manual_seed(0)
    fusion = Fusion(problem, views)
    found = fitted_views(fusion, material, light, generator)
    assert {name: maps.shape[-1] for name, maps in found.items()} == RENDERS
    surface, whole = problem.renderer.surface, problem.gbuffer
    for name, values in (("albedo", material.albedo), ("roughness", material.roughness)):
        torch.testing.assert_close(found[name], texture_images(surface, whole, values)[list(views)])
    many = problem.renderer.render_images(whole, material, light, 8 * SAMPLES, torch.Generator().manual_seed(1))
    for name in ("radiance", "specular"):
        torch.testing.assert_close(found[name].mean(), many[name][list(views)].mean(), rtol=0.02, atol=0)
    asked = evidence(fusion, found, len(texture))
    torch.testing.assert_close(found["evidence"], texture_images(surface, whole, asked)[list(views)])
    every = evidence(Fusion(problem, tuple(range(len(many["radiance"])))), many, len(texture))
    assert float((texture_images(surface, whole, every)[list(views)] - found["evidence"]).abs().mean()) > 0.01


def test_a_prior_that_cannot_is_refused(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"fit\.regularise: expected a prior with a method refine.*found NoPrior"):
        refined(problem, NoPrior(), 0.5)
