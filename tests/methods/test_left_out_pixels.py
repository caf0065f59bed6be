"""What a mask leaves out of a photograph says nothing: not to couplings, regularisers or means, and none of it is black."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, altered
from torch import Tensor

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.couplings.sampler import pixel_samples
from ia_bench.methods.regularisers.context import effective_view_count
from ia_bench.methods.regularisers.fusion import Fusion
from ia_bench.methods.regularisers.refiner import fitted_views
from ia_bench.methods.truth_seers import Constant, NoOptions
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.priors.contract import Samples
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene


def cut_off(problem: Problem) -> Problem:
    """The problem with what lies within two pixels of every silhouette cut off."""
    scene = captured(problem.scene, CaptureSettings(margin=2.0), lambda line: None)
    return altered(problem, scene=scene)


def masks(problem: Problem) -> Tensor:
    return torch.from_numpy(np.stack([view.mask for view in problem.scene.train]))[..., None]


def test_pixels_that_the_mesh_fills_and_a_mask_leaves_out(problem: Problem) -> None:
    whole, cut = problem.photographs, cut_off(problem).photographs
    assert not whole.left_out.any()
    assert whole.known is None
    filled = problem.gbuffer.filled
    assert torch.equal(cut.left_out, filled & (cut.mask[:, 0] == 0))
    assert 0.05 < float(cut.left_out[filled].float().mean()) < 0.7
    kept = filled & ~cut.left_out & (whole.mask[:, 0] == 1)
    torch.testing.assert_close(cut.radiance[kept], whole.radiance[kept])


def test_a_prior_that_is_right_corrects_nothing_and_targets_nothing_there(problem: Problem, scene: Scene) -> None:
    """Its answer is premultiplied by the mask, so that it is black where the mask is."""
    cut = cut_off(problem)
    assert scene.truth is not None
    assert scene.truth.albedo is not None
    texture = torch.from_numpy(scene.truth.albedo).float()
    shown = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    answer, views = shown * (masks(cut) > 0), tuple(range(len(cut.scene.train)))
    fusion = Fusion(cut, views)
    material, nothing = Material(texture, texture[..., :1]), fusion.pixels(shown[..., :1])
    moved = fusion.moved(material, (fusion.pixels(shown), fusion.pixels(answer), 1.0), (nothing, nothing, 1.0))
    torch.testing.assert_close(moved.albedo, texture, rtol=0, atol=1e-5)
    targets = pixel_samples(cut, Samples({"albedo": answer}), views)
    black = problem.gbuffer.filled & (targets.values["albedo"].amax(-1) == 0)
    assert black.any()
    assert not targets.weight[black].any()
    assert float(targets.weight.mean()) == pytest.approx(1, rel=1e-5)


def test_texels_that_are_seen_in_such_pixels_alone_are_not_seen(problem: Problem) -> None:
    few = altered(problem, scene=replace(problem.scene, train=problem.scene.train[:2]))
    vars(few).pop("gbuffer")
    cut = cut_off(few)
    whole_sees, cut_sees = (Parameters(one, SETTINGS).observed for one in (few, cut))
    assert not (cut_sees & ~whole_sees).any()
    assert 0.05 < float((whole_sees & ~cut_sees).float().sum() / whole_sees.float().sum()) < 0.7
    assert float(effective_view_count(cut, 64).sum()) < 0.95 * float(effective_view_count(few, 64).sum())


def test_the_constants_light_is_that_of_the_pixels_that_are_known(problem: Problem, scene: Scene) -> None:
    """The mean of what lies inside is about that of all; black in a third of the pixels would be a third less."""
    lights = []
    for one in (problem, cut_off(problem)):
        found = Constant(NoOptions()).fit(altered(one, truth=scene), seed=0, monitor=Monitor.silent())
        assets = found.reconstruction.assets()
        assert assets is not None
        lights.append(assets.light[0, 0])
    np.testing.assert_allclose(lights[1], lights[0], rtol=0.2)


def test_what_a_prior_is_shown_of_a_fit_is_exposed_as_the_photographs_are(problem: Problem, scene: Scene) -> None:
    """A fit that is right is as far off as before where the photographs' factors are known, and by these where they are not."""
    assert scene.truth is not None
    assert scene.truth.albedo is not None
    assert scene.truth.roughness is not None
    factors = torch.linspace(-1, 1, len(problem.scene.train)).exp()
    views = tuple(range(1, len(factors)))
    exposed = altered(problem, scene=replace(problem.scene, train=tuple(
        replace(view, image=float(factor) * view.image) for view, factor in zip(problem.scene.train, factors, strict=True)
    )))  # fmt: skip
    material = Material(*(torch.from_numpy(one).float() for one in (scene.truth.albedo, scene.truth.roughness[..., None])))
    light = SampledLight.of(torch.from_numpy(scene.truth.lights["train"]).float())

    def off(one: Problem, exposures: Tensor | None) -> float:
        generator = torch.Generator().manual_seed(0)
        shown = fitted_views(one, Fusion(one, views), views, material, light, generator, exposures)
        return float(shown["evidence"][..., 0].square().mean().sqrt())

    before, known, unknown = off(problem, None), off(exposed, factors), off(exposed, None)
    assert known == pytest.approx(before, rel=0.1)
    assert unknown > 1.5 * known
