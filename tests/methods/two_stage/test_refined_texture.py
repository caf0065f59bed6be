"""What a prior is shown of a finished fit, from all around; what it corrects reaches the texture, and nothing else of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch
from small_fit import SETTINGS, Found, Record, altered, fit
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.evidence import DARK, evidence, photographed_evidence
from ia_bench.methods.two_stage.looks import looks
from ia_bench.methods.two_stage.refinement import OFFSET, Fusion, refined_albedo, refined_roughness
from ia_bench.methods.two_stage.surroundings import CAMERAS, FILLED, LOWEST, SIDE, cameras_around, pictures
from ia_bench.priors.contract import PICTURES, Observations, PriorInfo, Samples
from ia_bench.priors.none import NoPrior
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Camera, Scene

QUICK = replace(SETTINGS, stage1_steps=8, stage2_steps=4)


class Told:
    """Says nothing while a fit runs; corrects its albedo to the truth, at a level of its own, and its roughness to one value."""

    info = PriorInfo(frozenset())

    def __init__(self, truth: Tensor, level: float = 1.0, roughness: float | None = None) -> None:
        self.truth, self.level, self.roughness = truth, level, roughness
        self.asked: list[Mapping[str, Tensor]] = []

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        return Samples({})

    def refine(self, pictures: Mapping[str, Tensor]) -> Samples:
        self.asked.append(pictures)
        rough = {} if self.roughness is None else {"roughness": self.roughness * pictures["mask"]}
        return Samples({"albedo": self.level * self.truth, **rough}, {}, {"network_calls": len(self.truth)})


def around(problem: Problem) -> tuple[list[Camera], GBuffer]:
    """What a run takes pictures with: as many pixels as its photographs have."""
    cameras = cameras_around(problem.scene.expect_mesh().vertices, CAMERAS, problem.gbuffer.shape[1])
    return cameras, problem.stage.gbuffer(cameras, SIDE)


def true_texture(scene: Scene) -> Tensor:
    assert scene.truth is not None
    assert scene.truth.albedo is not None
    return torch.from_numpy(scene.truth.albedo).float()


def true_views(problem: Problem, scene: Scene) -> tuple[Tensor, Tensor]:
    texture = true_texture(scene)
    return texture_images(problem.renderer.surface, around(problem)[1], texture), texture


def refined(problem: Problem, prior: object, share: float, **more: object) -> Found:
    supervision = SupervisionSettings(refinement=share, **more)  # type: ignore[arg-type]
    return fit(altered(problem, supervision=supervision), prior, QUICK, Record())  # type: ignore[arg-type]


def aligned_error(problem: Problem, found: Tensor, truth: Tensor) -> float:
    """Root mean square over wholly covered pixels of the pictures, one scale for all."""
    gbuffer = around(problem)[1]
    images = texture_images(problem.renderer.surface, gbuffer, found)
    inside = gbuffer.coverage() == 1
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
    assert whole.counters["network_calls"] == CAMERAS
    (shown,) = prior.asked
    assert {name: maps.shape[-1] for name, maps in shown.items()} == PICTURES
    exact = texture_images(problem.renderer.surface, around(problem)[1], plain.material.albedo)
    torch.testing.assert_close(shown["albedo"], exact, atol=2e-2, rtol=0)


def test_the_level_is_not_asked_for(problem: Problem, scene: Scene) -> None:
    truth, _ = true_views(problem, scene)
    dark, bright = (refined(problem, Told(truth, level), 1.0).material.albedo for level in (0.6, 0.9))
    inside = problem.gbuffer.coverage() == 1
    seen = [texture_images(problem.renderer.surface, problem.gbuffer, albedo)[inside] for albedo in (dark, bright)]
    torch.testing.assert_close(seen[0].mean(), seen[1].mean(), rtol=0.03, atol=0)  # but for the floor of the quotient


def test_no_correction_is_no_change(problem: Problem, scene: Scene) -> None:
    texture = true_views(problem, scene)[1]
    render = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    fusion = Fusion(problem.renderer.surface, problem.gbuffer)
    shown = fusion.pixels(render)
    same = refined_albedo(fusion, texture, shown, shown.clone(), 1.0)
    torch.testing.assert_close(same, texture, rtol=0, atol=1e-5)
    scaled = refined_albedo(fusion, texture, shown + OFFSET, 2 * shown + 2 * OFFSET - OFFSET, 1.0)
    assert float((scaled - texture).abs().max()) < 0.2


def test_some_views_change_what_they_see_and_the_rest_follows(problem: Problem, scene: Scene) -> None:
    """A correction of one half of the object in two views: texels that show it change most, and values stay valid."""
    texture = 0.5 * torch.ones_like(true_views(problem, scene)[1])
    views = (0, 5)
    render = texture_images(problem.renderer.surface, problem.gbuffer, texture)[list(views)]
    side = torch.ones_like(render)
    side[:, :, : render.shape[2] // 2] = 1.3
    fusion = Fusion.of_photographs(problem, views)
    changed = refined_albedo(fusion, texture, fusion.pixels(render), fusion.pixels(render * side), 1.0)
    assert float(changed.min()) >= 0
    assert float(changed.max()) <= 1
    ratio = changed / texture
    assert float(ratio.max()) / float(ratio.min()) > 1.25


def test_roughness_follows_by_its_share(problem: Problem, scene: Scene) -> None:
    truth, _ = true_views(problem, scene)
    found = refined(problem, Told(truth, roughness=0.3), 0.0, roughness_refinement=1.0)
    plain = fit(problem, NoPrior(), QUICK, Record())
    torch.testing.assert_close(found.material.albedo, plain.material.albedo, rtol=0, atol=1e-6)
    inside = problem.gbuffer.coverage() == 1
    shown = texture_images(problem.renderer.surface, problem.gbuffer, found.material.roughness)[inside]
    before = texture_images(problem.renderer.surface, problem.gbuffer, plain.material.roughness)[inside]
    assert float((shown - 0.3).abs().mean()) < 0.3 * float((before - 0.3).abs().mean())


def test_roughness_is_a_mean_and_stays_valid(problem: Problem, scene: Scene) -> None:
    texture = 0.5 * torch.ones_like(true_views(problem, scene)[1][..., :1])
    render = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    fusion = Fusion(problem.renderer.surface, problem.gbuffer)
    shown = fusion.pixels(render)
    torch.testing.assert_close(refined_roughness(fusion, texture, shown, shown + 0.2, 0.5), texture + 0.1)
    assert float(refined_roughness(fusion, texture, shown, shown + 3, 1.0).max()) == 1
    assert float(refined_roughness(fusion, texture, shown, shown - 3, 1.0).min()) == pytest.approx(0.03)


def test_evidence_is_what_all_photographs_say(problem: Problem) -> None:
    """A radiance half as bright as every photograph is off by log 2, a stop; a place is as shiny as in the mean over views."""
    views = problem.scene.train
    photographs = torch.stack([torch.from_numpy(view.image) for view in views])
    fusion = Fusion.of_photographs(problem, tuple(range(len(views))))
    mean = fusion.pixels(photographs).mean()
    half = (photographs + DARK * mean) / 2 - DARK * mean
    grey = half.mean(-1, keepdim=True)
    renders = {"radiance": half, "specular": (0.2 * (grey + DARK * mean)).expand_as(half), "albedo": photographs}
    found = evidence(fusion, views, renders, 64)
    assert {name: texture.shape[-1] for name, texture in found.items()}.items() <= PICTURES.items()
    for name, value in (("shine", 0.2), ("misfit", 0.6931), ("residual", 1.0)):
        near = (found[name] - value).abs() < 0.05 * value
        assert float(near.float().mean()) > 0.995, name  # but for channels that are darker than the offset
    bounds = [replace(view, valid=torch.zeros(view.mask.shape).bool().numpy()) for view in views]
    of_bounds = evidence(fusion, bounds, renders, 64)
    assert not of_bounds["misfit"].any()
    assert not of_bounds["residual"].any()


def test_shading_is_what_the_albedo_leaves_of_matt_photographs(problem: Problem) -> None:
    """Photographs that are the albedo under lights of one and two stops: their mean, and how much they differ, at any level."""
    views = problem.scene.train
    painted = torch.stack([torch.from_numpy(view.mask)[..., None].expand(-1, -1, 3) for view in views]) * 0.3
    factor = torch.where(torch.arange(len(views)) % 2 == 0, 1.0, 2.0)[:, None, None, None]
    lit = [replace(view, image=(5 * image).numpy()) for view, image in zip(views, painted * factor, strict=True)]
    fusion = Fusion.of_photographs(problem, tuple(range(len(views))))
    renders = {"radiance": 5 * painted, "specular": torch.zeros_like(painted), "albedo": painted}
    found = evidence(fusion, lit, renders, 64)
    grey = found["shading"].mean(-1, keepdim=True)
    variance = found["squared_shading"] - grey.square()
    assert float(variance.min()) > -1e-4
    assert float(variance.max()) == pytest.approx(0.25, rel=0.15)  # of a stop that half of the views have, but for the offset
    assert float(grey.max() - grey.min()) == pytest.approx(1, rel=0.15)


def test_pictures_show_the_textures_from_all_around(problem: Problem, scene: Scene) -> None:
    texture = true_texture(scene)
    material, light = Material(texture, 0.2 + 0.5 * texture[..., :1]), SampledLight.of(torch.ones(16, 32, 3))
    said = photographed_evidence(problem, (0, 3, 5), material, light, torch.Generator().manual_seed(0))
    cameras, gbuffer = around(problem)
    straight = looks(problem, len(texture))
    found = pictures(problem, gbuffer, cameras, material, said, straight)
    assert {name: maps.shape[-1] for name, maps in found.items()} == PICTURES
    surface, mask = problem.renderer.surface, found["mask"]
    for name, values in (("albedo", material.albedo), ("roughness", material.roughness), ("looks", straight[..., None])):
        torch.testing.assert_close(found[name], texture_images(surface, gbuffer, values))
    assert all(not maps[mask[..., 0] == 0].any() for maps in found.values())
    vertices = torch.from_numpy(problem.scene.expect_mesh().vertices).float()
    low, high = vertices.amin(0), vertices.amax(0)
    height = 0.5 * float((high - low)[2] / (high - low).norm())
    inside = mask[..., 0] == 1
    assert float(found["places"][inside][:, 0].abs().max()) <= height + 1e-4
    assert float(found["places"][inside][:, 0].max()) > 0.8 * height


def test_cameras_fill_their_frames_and_spread_over_directions() -> None:
    vertices = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)).numpy() * [1.0, 2.0, 3.0] + 7
    cameras = cameras_around(vertices, 16, 40)
    middle = 0.5 * (vertices.min(0) + vertices.max(0))
    heights = []
    for camera in cameras:
        toward = camera.to_world[:3, 3] - middle
        heights.append(toward[2] / (toward @ toward) ** 0.5)
        local = (vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
        column = camera.focal[0] * local[:, 0] / -local[:, 2] + camera.centre[0]
        row = -camera.focal[1] * local[:, 1] / -local[:, 2] + camera.centre[1]
        sides = [(place.max() - place.min()) / 40 for place in (row, column)]
        assert max(sides) == pytest.approx(FILLED, abs=1e-6)
        for place in (row, column):
            assert place.min() + place.max() == pytest.approx(40, abs=1e-3)
    assert heights == sorted(heights)
    assert LOWEST < heights[0] < heights[-1] < 1


def test_a_prior_that_cannot_is_refused(problem: Problem) -> None:
    for name in ("refinement", "roughness_refinement"):
        supervision = SupervisionSettings(**{name: 0.5})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=rf"prior\.supervision\.{name}=0\.5: expected a prior with a method refine"):
            fit(altered(problem, supervision=supervision), NoPrior(), QUICK, Record())
