"""Every kind of supervision through the whole trainer: it helps as it should, repeats, and resumes to the same bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from small_fit import Record, fit, make_problem, same
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.asking.views import evenly_spread
from ia_bench.methods.contract import Fit, Problem
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings, LossWeights, SupervisionSettings
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene

SETTINGS = FitSettings(stage1_steps=6, stage2_steps=4, pixels=128, checkpoint_seconds=1e9)

KINDS: dict[str, dict[str, Any]] = {
    "similarity": {"kind": "similarity"},
    "few views": {"views": 3},
    "sds": {"kind": "sds", "sds_period": 3, "sds_views": 2},
}


@pytest.fixture(scope="module")
def scene(tiny: Scene) -> Scene:
    """Every third training view of scene tiny."""
    return replace(tiny, train=tiny.train[::3])


@pytest.fixture(scope="module")
def problem(scene: Scene) -> Problem:
    return make_problem(scene.blind())


class Noisy(OraclePrior):
    """The spoiled oracle, which also denoises: with a Gaussian around its truth, the estimate is their weighted mean."""

    def __init__(self, views: tuple[int, ...], images: Tensor) -> None:
        super().__init__(noise=0.1, scale=0.2)
        self._images = images[list(views)]
        self.counters = {"distilled": 0}
        self.asked: list[tuple[str, int, int]] = []  # which question, of how many views, with which seed

    def sample(
        self, images: Tensor, masks: Tensor, *, seed: int, guidance: Mapping[str, Tensor] | None = None
    ) -> dict[str, Tensor]:
        self.asked.append(("sample" if guidance is None else "guided", len(images), seed))
        self.network_calls += 10
        return super().sample(images, masks, seed=seed, guidance=guidance)

    def distill(self, images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], *, seed: int) -> dict[str, Tensor]:
        self.asked.append(("distill", len(images), seed))
        self.network_calls += 1
        self.counters = {"distilled": self.counters["distilled"] + len(images)}
        level = np.random.default_rng(seed).uniform(0.2, 0.8)
        views = [int((self._images - image).abs().sum((1, 2, 3)).argmin()) for image in images]
        truth = {name: torch.from_numpy(self._truth[name])[views] for name in renders}
        return {name: level * truth[name] + (1 - level) * render for name, render in renders.items()}


def noisy(scene: Scene, problem: Problem) -> Noisy:
    views = evenly_spread(scene, problem.supervision.views)
    prior = Noisy(views, torch.from_numpy(np.stack([view.image for view in scene.train])))
    prior.reveal(tuple(scene.train[view] for view in views))
    return prior


def supervised(problem: Problem, **settings: Any) -> Problem:
    return replace(problem, supervision=SupervisionSettings(**settings))


def albedo_error(problem: Problem, scene: Scene, albedo: Tensor) -> float:
    """RMS of sRGB albedo over the training views' inner pixels, after one scale for the scene."""
    picture = texture_images(problem.renderer.surface, problem.gbuffer, albedo).numpy()
    inside = np.stack([view.mask for view in scene.train]) > 0.99
    picture, truth = picture[inside], np.stack([view.albedo for view in scene.train])[inside]
    aligned = picture * (truth.mean() / picture.mean())
    return float(np.sqrt(((linear_to_srgb(aligned.clip(0, 1)) - linear_to_srgb(truth)) ** 2).mean()))


# ---- it resumes ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=KINDS)
def uninterrupted(request: pytest.FixtureRequest, problem: Problem, scene: Scene) -> tuple[Fit, Record, Problem]:
    """A whole fit that has kept its state after every step."""
    changed, record = supervised(problem, **KINDS[request.param]), Record()
    return fit(changed, noisy(scene, changed), replace(SETTINGS, checkpoint_seconds=0.0), record), record, changed


@pytest.mark.parametrize("step", [4, 6, 8], ids=["in stage 1", "at the boundary", "in stage 2"])
def test_resumed_fit_ends_with_the_same_bits(
    uninterrupted: tuple[Fit, Record, Problem], step: int, scene: Scene, record: Record
) -> None:
    whole, kept, changed = uninterrupted
    torch.manual_seed(1234)
    resumed = fit(changed, noisy(scene, changed), SETTINGS, record, resume=kept.states[step])
    assert record.losses == kept.losses[step:]
    assert same(resumed, whole)
    assert resumed.counters == whole.counters  # what was spent before the interruption counts


def test_kinds_differ(problem: Problem, scene: Scene) -> None:
    fits = []
    for settings in ({}, *KINDS.values()):
        changed = supervised(problem, **settings)
        fits.append(fit(changed, noisy(scene, changed), SETTINGS, Record()))
    assert not any(same(a, b) for n, a in enumerate(fits) for b in fits[:n])


# ---- the prior is asked as the settings say --------------------------------------------------------------------------


def test_views_that_are_asked_for(problem: Problem, scene: Scene) -> None:
    changed = supervised(problem, views=4)
    prior = noisy(scene, changed)
    found = fit(changed, prior, SETTINGS, Record())
    assert [(what, views) for what, views, _ in prior.asked] == [("sample", 4), ("guided", 4)]
    steps = {"skipped_steps": 0, "cast_blocked_steps": 0, "samples_per_pixel": 16}
    assert found.counters == {"network_calls": 20, "prior_cached": 0, "distilled": 0, **steps}


def test_distillation_follows_its_period(problem: Problem, scene: Scene) -> None:
    changed = supervised(problem, kind="sds", sds_period=3, sds_views=2, views=4)
    prior = noisy(scene, changed)
    found = fit(changed, prior, SETTINGS, Record())
    assert [(what, views) for what, views, _ in prior.asked] == [("distill", 2)] * 4  # steps 0, 3, 6, 9
    assert len({seed for *_, seed in prior.asked}) == 4
    assert (found.counters["network_calls"], found.counters["distilled"]) == (4, 8)
    assert found.seconds["prior"] > 0


def test_distillation_of_a_prior_that_cannot(problem: Problem, scene: Scene, record: Record) -> None:
    prior = OraclePrior()
    prior.reveal(scene.train)
    with pytest.raises(InputError, match=r"kind=sds: expected a prior with a method distill.*found OraclePrior"):
        fit(supervised(problem, kind="sds"), prior, SETTINGS, record)


@pytest.mark.parametrize("kind", ["target", "similarity", "sds"])
def test_albedo_can_be_switched_off(problem: Problem, scene: Scene, kind: str) -> None:
    changed = supervised(problem, kind=kind)
    settings = replace(SETTINGS, guided=False, weights=LossWeights(albedo=0.0))
    exact, spoiled = noisy(scene, changed), noisy(scene, changed)
    spoiled.reveal(tuple(replace(view, albedo=view.albedo[::-1].copy()) for view in scene.train))
    assert same(fit(changed, exact, settings, Record()), fit(changed, spoiled, settings, Record()))


# ---- it helps --------------------------------------------------------------------------------------------------------


def test_kernel_does_not_mind_the_scale_of_a_view(problem: Problem, scene: Scene) -> None:
    """A prior whose albedo is exact up to a random scale per view is as good a kernel as the exact one, to float errors."""
    settings = replace(SETTINGS, guided=False, stage1_steps=30, pixels=256, weights=LossWeights(specular=0.0))
    changed = supervised(problem, kind="similarity", kernel_weight=1.0)
    errors = []
    for factor in (1.0, 0.5):
        prior = OraclePrior(components=["albedo"])
        random = np.random.default_rng(0)
        scales = np.exp(0.3 * random.standard_normal(6) - 1.0).astype(np.float32) if factor < 1 else np.ones(6, np.float32)
        prior.reveal(tuple(replace(view, albedo=s * view.albedo) for view, s in zip(scene.train, scales, strict=True)))
        errors.append(albedo_error(problem, scene, fit(changed, prior, settings, Record()).material.albedo))
    assert errors[1] == pytest.approx(errors[0], rel=0.01)


class Gaussian:
    """A distribution of albedo N(mean, 1) around a texture's picture, as a distiller sees it: noised and denoised."""

    provides = frozenset({"albedo"})
    encoding: Mapping[str, str] = {"albedo": "srgb"}
    stochastic = True
    guidable = False
    resolution: int | None = None
    sees_truth = False
    network_calls = 0

    def __init__(self, images: Tensor, mean: Tensor) -> None:
        self._images, self._mean = images, mean

    def sample(self, *_: object, **__: object) -> dict[str, Tensor]:
        raise AssertionError("a distiller is not sampled")

    def distill(self, images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], *, seed: int) -> dict[str, Tensor]:
        """E[x0 | x_t] of a Gaussian of variance 1: with noise of variance v, (mean v + x_t) / (1 + v), x_t = render + noise."""
        random = np.random.default_rng(seed)
        variance = float(np.exp(random.uniform(-2, 2)))
        views = [int((self._images - image).abs().sum((1, 2, 3)).argmin()) for image in images]
        noise = 0.05 * torch.from_numpy(random.standard_normal(images.shape).astype(np.float32)) * masks[..., None]
        estimate = (variance * self._mean[views] + renders["albedo"] + noise) / (1 + variance)
        return {"albedo": estimate.clamp(0, 1) * (masks > 0)[..., None]}


def test_distilled_gaussian_converges_to_its_mean(problem: Problem, scene: Scene) -> None:
    """Without an image loss nothing but the prior's mean is left: the albedo must become it, here a painted texture."""
    texture = 0.2 + 0.6 * torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(5))
    texture = texture.repeat_interleave(8, 0).repeat_interleave(8, 1)
    mean = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    prior = Gaussian(torch.from_numpy(np.stack([view.image for view in scene.train])), mean)
    weights = LossWeights(image=0.0, smooth_albedo=0.0, smooth_roughness=0.0)
    settings = replace(SETTINGS, stage1_steps=120, stage2_steps=0, pixels=512, albedo_start=0.0, weights=weights)
    changed = supervised(problem, kind="sds", sds_period=3, sds_views=4)
    found = fit(changed, prior, settings, Record()).material.albedo
    inner = (problem.gbuffer.face >= 0).all(1)

    def distance(albedo: Tensor) -> float:
        seen = problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, albedo))
        return float((seen - problem.pixels_of(mean))[inner].abs().mean())

    assert distance(found) < 0.15 * distance(torch.full_like(texture, SETTINGS.albedo_initial))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "kernel"}, r"prior\.supervision\.kind: expected one of target, similarity, sds, found 'kernel'"),
        ({"kernel_scale": 0.0}, r"prior\.supervision\.kernel_scale: expected a finite number > 0, found 0\.0"),
        ({"radius": float("nan")}, r"prior\.supervision\.radius: .*found nan"),
        ({"target_weight": -1.0}, r"prior\.supervision\.target_weight: expected a finite number >= 0, found -1\.0"),
        ({"sds_views": 0}, r"prior\.supervision\.sds_views: expected at least 1, found 0"),
        ({"views": 0}, r"prior\.supervision\.views: expected a number of views >= 1, all or auto, found 0"),
        ({"views": "some"}, r"prior\.supervision\.views: .*found some"),
    ],
)
def test_impossible_settings(problem: Problem, scene: Scene, record: Record, settings: dict, message: str) -> None:
    changed = supervised(problem, **settings)
    with pytest.raises(InputError, match=message):
        TwoStage().fit(changed, OraclePrior(), SETTINGS, seed=0, monitor=record.monitor())
