"""Bounds, pixels that a mask leaves out, and the unit of radiance: what photographs do not say pulls a fit nowhere."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Record, altered, first_two, fit, losses_of, make_problem
from torch import Tensor

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods import photographs
from ia_bench.methods.contract import Problem
from ia_bench.methods.couplings.sampler import pixel_samples
from ia_bench.methods.photographs import Photographs, one_sided, stacked
from ia_bench.methods.regularisers.completing import effective_view_count
from ia_bench.methods.regularisers.fusion import Fusion
from ia_bench.methods.regularisers.refiner import fitted_views
from ia_bench.methods.two_stage import losses, parameters
from ia_bench.methods.two_stage.losses import dual_buffer_loss, neighbouring_pixels
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.priors.contract import NoPrior, Samples
from ia_bench.render import gbuffer as pixels_of_views
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene

CLIP = torch.full((3, 3), 0.5)
KNOWN = torch.tensor([[True], [False], [False]])
BRIGHTER, DARKER = 0.8, 0.2


def gradients(value: torch.Tensor, of: torch.Tensor) -> torch.Tensor:
    return torch.autograd.grad(value, of)[0].abs().sum(1)


def test_one_sided_targets() -> None:
    rendered = torch.tensor([[BRIGHTER] * 3, [BRIGHTER] * 3, [DARKER] * 3], requires_grad=True)
    error = (rendered - one_sided(CLIP, rendered, KNOWN)).abs()
    torch.testing.assert_close(error.detach()[:, 0], torch.tensor([0.3, 0.0, 0.3]))
    torch.testing.assert_close(gradients(error.sum(), rendered), torch.tensor([3.0, 0.0, 3.0]))


def test_the_crossed_loss_is_one_sided_in_both_halves() -> None:
    first = torch.tensor([[BRIGHTER] * 3, [BRIGHTER] * 3, [DARKER] * 3], requires_grad=True)
    second = first.detach().clone().requires_grad_(True)
    one_sidedly, as_ever = (dual_buffer_loss(first, second, CLIP, 0.1, known) for known in (KNOWN, torch.ones_like(KNOWN)))
    for half in (first, second):
        given, usual = (gradients(loss, half) for loss in (one_sidedly, as_ever))
        assert usual.min() > 0
        assert given.tolist() == [usual[0], 0, usual[2]]
        one_sidedly, as_ever = (dual_buffer_loss(first, second, CLIP, 0.1, known) for known in (KNOWN, torch.ones_like(KNOWN)))


def pulls(problem: Problem, pixels: Tensor) -> dict[str, float]:
    """How hard a loss of these pixels pulls at each of a fit's tensors, without smoothness."""
    settings = replace(SETTINGS, weights=replace(SETTINGS.weights, smooth_albedo=0, smooth_roughness=0, smooth_light=0))
    parameters = Parameters(problem, settings)
    losses, _ = losses_of(problem, settings)(pixels, parameters, 50, 100, torch.Generator().manual_seed(0))
    sum(losses.values()).backward()
    return {name: float(parameters.tensors[name].grad.abs().sum()) for name in ("albedo", "log_light")}


def test_a_loss_of_unknown_pixels_pulls_nothing(tiny: Scene) -> None:
    """Black and unknown everywhere: no render is too bright. Known and black: every texture and the light are pulled down."""
    found = {}
    for known in (True, False):
        valid = np.full((32, 32), known)
        black = replace(tiny, train=tuple(replace(v, image=0 * v.image, valid=valid) for v in tiny.train))
        found[known] = pulls(make_problem(black.blind()), torch.arange(200))
    assert min(found[True].values()) > 0
    assert max(found[False].values()) == 0


def test_photographs_are_looked_up_in_their_own_views_of_which_one_at_a_time_is_copied(problem: Problem) -> None:
    """Some have a mask of what is known, some have not. Against a loop over pixels; numpy never holds a third of all views."""
    rng, views = np.random.default_rng(0), []
    for number, view in enumerate(problem.scene.train):
        valid = None if number % 2 else rng.random(view.mask.shape) > 0.3
        views.append(replace(view, image=rng.random(view.image.shape, np.float32), mask=view.mask * (number + 1) / 50, valid=valid))
    scene, gbuffer = replace(problem.scene, train=tuple(views)), problem.gbuffer
    tracemalloc.start()
    found, (_, peak) = Photographs.of(scene, gbuffer), tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < sum(view.image.nbytes for view in views) / 3
    count, height, width = gbuffer.shape
    assert count == len(views)
    for entry, flat in list(enumerate(gbuffer.pixel.tolist()))[::7]:
        number, place = flat // (height * width), (flat // width % height, flat % width)
        assert found.radiance[entry].tolist() == views[number].image[place].tolist()
        assert float(found.mask[entry]) == views[number].mask[place]
        out = bool(found.left_out[entry])
        assert bool(found.known[entry]) == (not out and (views[number].valid is None or bool(views[number].valid[place])))
    with pytest.raises(IndexError):  # what is not in the order of its views
        Photographs.of(scene, gbuffer.at(torch.arange(len(gbuffer.pixel)).flip(0)))


def test_what_is_prepared_in_parts_is_what_it_is_at_once(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    def prepared() -> list[Tensor]:
        pairs = neighbouring_pixels(problem, problem.photographs.radiance, 0.1)
        uv = problem.renderer.surface.uv(problem.gbuffer.face.clamp_min(0).long(), problem.gbuffer.barycentric)
        return [pairs.index, pairs.similarity, pairs.uv, uv, Parameters(problem, SETTINGS).observed]

    whole = prepared()
    assert len(problem.gbuffer.pixel) > 1000
    for module in (pixels_of_views, losses, parameters):
        monkeypatch.setattr(module, "PIXELS_AT_ONCE", 100)
    assert all(torch.equal(part, one) for part, one in zip(prepared(), whole, strict=True))


def cut_off(problem: Problem) -> Problem:
    """The problem with what lies within two pixels of every silhouette cut off."""
    scene = captured(problem.scene, CaptureSettings(margin=2.0), lambda line: None)
    return altered(problem, scene=scene)


def test_pixels_that_the_mesh_fills_and_a_mask_leaves_out(problem: Problem) -> None:
    whole, cut = problem.photographs, cut_off(problem).photographs
    assert not whole.left_out.any()
    assert whole.known.all()
    filled = problem.gbuffer.filled
    assert torch.equal(cut.left_out, filled & (cut.mask[:, 0] == 0))
    assert 0.05 < float(cut.left_out[filled].float().mean()) < 0.7
    kept = filled & ~cut.left_out & (whole.mask[:, 0] == 1)
    torch.testing.assert_close(cut.radiance[kept], whole.radiance[kept])


def test_a_prior_that_is_right_corrects_nothing_and_targets_nothing_there(problem: Problem, scene: Scene) -> None:
    """Its answer is premultiplied by the mask, so that it is black where the mask is."""
    cut = cut_off(problem)
    texture = torch.from_numpy(scene.truth.albedo).float()
    shown = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    answer, views = shown * (stacked(cut.scene.train, "mask")[..., None] > 0), tuple(range(len(cut.scene.train)))
    fusion = Fusion(cut, views)
    material, nothing = Material(texture, texture[..., :1]), fusion.pixels(shown[..., :1])
    moved = fusion.moved(material, (fusion.pixels(shown), fusion.pixels(answer), 1.0), (nothing, nothing, 1.0))
    torch.testing.assert_close(moved.albedo, texture, rtol=0, atol=1e-5)
    targets = pixel_samples(cut, Samples({"albedo": answer}), views)
    black = problem.gbuffer.filled & (targets.values["albedo"].amax(-1) == 0)
    assert black.any()
    assert not targets.weight[black].any()
    assert float(targets.weight.mean()) == pytest.approx(1, rel=1e-5)


def test_texels_that_are_seen_in_such_pixels_alone_are_not_seen_and_these_pull_nowhere(problem: Problem) -> None:
    few = first_two(problem)
    cut = cut_off(few)
    whole_sees, cut_sees = (Parameters(one, SETTINGS).observed for one in (few, cut))
    assert not (cut_sees & ~whole_sees).any()
    assert 0.05 < float((whole_sees & ~cut_sees).float().sum() / whole_sees.float().sum()) < 0.7
    assert float(effective_view_count(cut, 64).sum()) < 0.95 * float(effective_view_count(few, 64).sum())
    # their photograph is black, and the loss has a gradient in none of them, where the same pixels pull in whole masks
    cut = cut_off(problem)
    pixels = torch.nonzero(cut.photographs.left_out)[:, 0]
    assert 100 < len(pixels) < 0.5 * len(cut.photographs.left_out)
    assert pulls(problem, pixels)["albedo"] > 0
    assert pulls(cut, pixels)["albedo"] == 0


def test_what_a_prior_is_shown_of_a_fit_is_exposed_as_the_photographs_are(problem: Problem, scene: Scene) -> None:
    """A fit that is right is as far off as before where the photographs' factors are known, and by these where they are not."""
    factors = torch.linspace(-1, 1, len(problem.scene.train)).exp()
    views = tuple(range(1, len(factors)))
    exposed = altered(problem, scene=replace(problem.scene, train=tuple(
        replace(view, image=float(factor) * view.image) for view, factor in zip(problem.scene.train, factors, strict=True)
    )))  # fmt: skip
    material = Material(*(torch.from_numpy(one).float() for one in (scene.truth.albedo, scene.truth.roughness[..., None])))
    light = SampledLight.of(torch.from_numpy(scene.truth.lights["train"]).float())

    def off(one: Problem, exposures: Tensor | None) -> float:
        generator = torch.Generator().manual_seed(0)
        shown = fitted_views(Fusion(one, views), material, light, generator, exposures)
        return float(shown["evidence"][..., 0].square().mean().sqrt())

    before, known, unknown = off(problem, None), off(exposed, factors[:, None]), off(exposed, None)
    assert known == pytest.approx(before, rel=0.1)
    assert unknown > 1.5 * known


LONGER = replace(SETTINGS, stage1_steps=60, stage2_steps=30, pixels=512)


def exposed(problem: Problem, factor: float) -> Problem:
    """The problem with all photographs multiplied by ``factor``."""
    views = tuple(replace(view, image=view.image * np.float32(factor)) for view in problem.scene.train)
    return altered(problem, scene=replace(problem.scene, train=views))


def albedo_of(problem: Problem) -> Tensor:
    return fit(problem, NoPrior(), LONGER, Record()).material.albedo


@pytest.mark.parametrize("factor", [pytest.param(1e-4, marks=pytest.mark.slow), 1e5])
def test_photographs_of_another_unit_give_the_same_albedo(problem: Problem, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As photographs of the mean that others are brought to; compared as they are, dim ones give another albedo."""
    mean = float(exposed(problem, factor).photographs.radiance[problem.photographs.mask[:, 0] > 0.5].mean())
    usual = exposed(problem, factor * photographs.LEVEL / mean)
    assert usual.photographs.unit == 1
    expected, found = albedo_of(usual), albedo_of(exposed(problem, factor))
    assert float((found - expected).abs().mean()) < 0.02  # roundings differ, and steps enlarge them
    if factor < 1:
        monkeypatch.setattr(photographs, "USUAL", (0.0, float("inf")))
        assert float((albedo_of(exposed(problem, factor)) - expected).abs().mean()) > 0.06
