"""Every kind of supervision through the whole trainer: it helps as it should, repeats, and resumes to the same bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from small_fit import Found, Record, altered, fit, make_problem, same
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings, LossWeights
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.renderer import texture_images
from ia_bench.runs.truth import ToldPrior
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene

SETTINGS = FitSettings(stage1_steps=6, stage2_steps=4, pixels=128, checkpoint_seconds=1e9)

KINDS: dict[str, dict[str, Any]] = {
    "similarity": {"kind": "similarity"},
    "few views": {"views": 3},
    "few materials": {"parsimony": 1.0, "neighbours": 0.2, "symmetry": 0.5},
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

    def __init__(self) -> None:
        super().__init__(noise=0.1, scale=0.2)
        self.asked: list[tuple[str, int, int]] = []  # which question, of how many views, with which seed

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        self.asked.append(("sample" if guidance is None else "guided", len(observations.images), seed))
        samples = super().sample(observations, seed=seed, guidance=guidance)
        return replace(samples, cost={"network_calls": 10, "distilled": 0})

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        views = len(observations.images)
        self.asked.append(("distill", views, seed))
        level, truth = np.random.default_rng(seed).uniform(0.2, 0.8), observations.truth
        assert truth is not None
        values = {name: level * truth[name] + (1 - level) * render for name, render in renders.items()}
        return Samples(values, cost={"network_calls": 1, "distilled": views})


def noisy(scene: Scene) -> ToldPrior:
    return ToldPrior(Noisy(), scene.train)


def asked(prior: ToldPrior) -> list[tuple[str, int, int]]:
    assert isinstance(prior.prior, Noisy)
    return prior.prior.asked


def supervised(problem: Problem, **settings: Any) -> Problem:
    return altered(problem, supervision=SupervisionSettings(**settings))


def albedo_error(problem: Problem, scene: Scene, albedo: Tensor) -> float:
    """RMS of sRGB albedo over the training views' inner pixels, after one scale for the scene."""
    picture = texture_images(problem.renderer.surface, problem.gbuffer, albedo).numpy()
    inside = np.stack([view.mask for view in scene.train]) > 0.99
    picture, truth = picture[inside], np.stack([view.albedo for view in scene.train])[inside]
    aligned = picture * (truth.mean() / picture.mean())
    return float(np.sqrt(((linear_to_srgb(aligned.clip(0, 1)) - linear_to_srgb(truth)) ** 2).mean()))


# ---- it resumes ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=KINDS)
def uninterrupted(request: pytest.FixtureRequest, problem: Problem, scene: Scene) -> tuple[Found, Record, Problem]:
    """A whole fit that has kept its state after every step."""
    changed, record = supervised(problem, **KINDS[request.param]), Record()
    return fit(changed, noisy(scene), replace(SETTINGS, checkpoint_seconds=0.0), record), record, changed


@pytest.mark.parametrize("step", [4, 6, 8], ids=["in stage 1", "at the boundary", "in stage 2"])
def test_resumed_fit_ends_with_the_same_bits(
    uninterrupted: tuple[Found, Record, Problem], step: int, scene: Scene, record: Record
) -> None:
    whole, kept, changed = uninterrupted
    torch.manual_seed(1234)
    resumed = fit(changed, noisy(scene), SETTINGS, record, resume=kept.states[step])
    assert record.losses == kept.losses[step:]
    assert same(resumed, whole)
    assert resumed.counters == whole.counters  # what was spent before the interruption counts


def test_kinds_differ(problem: Problem, scene: Scene) -> None:
    fits = []
    for settings in ({}, *KINDS.values()):
        changed = supervised(problem, **settings)
        fits.append(fit(changed, noisy(scene), SETTINGS, Record()))
    assert not any(same(a, b) for n, a in enumerate(fits) for b in fits[:n])


# ---- the prior is asked as the settings say --------------------------------------------------------------------------


def test_views_that_are_asked_for(problem: Problem, scene: Scene) -> None:
    changed = supervised(problem, views=4)
    prior = noisy(scene)
    found = fit(changed, prior, SETTINGS, Record())
    assert [(what, views) for what, views, _ in asked(prior)] == [("sample", 4), ("guided", 4)]
    steps = {"corrections_clamped": 0, "skipped_steps": 0, "scale_ambiguity_blocked_steps": 0, "samples_per_pixel": 16}
    assert found.counters == {"network_calls": 20, "prior_cached": 0, "prior_absurd_values": 0, "distilled": 0, **steps}


def test_distillation_follows_its_period(problem: Problem, scene: Scene) -> None:
    changed = supervised(problem, kind="sds", sds_period=3, sds_views=2, views=4)
    prior = noisy(scene)
    found = fit(changed, prior, SETTINGS, Record())
    assert [(what, views) for what, views, _ in asked(prior)] == [("distill", 2)] * 4  # steps 0, 3, 6, 9
    assert len({seed for *_, seed in asked(prior)}) == 4
    assert (found.counters["network_calls"], found.counters["distilled"]) == (4, 8)
    assert found.seconds["prior"] > 0


def test_distillation_of_a_prior_that_cannot(problem: Problem, scene: Scene, record: Record) -> None:
    prior = ToldPrior(OraclePrior(), scene.train)
    with pytest.raises(InputError, match=r"kind=sds: expected a prior with a method distill.*found OraclePrior"):
        fit(supervised(problem, kind="sds"), prior, SETTINGS, record)


@pytest.mark.parametrize("kind", ["target", "similarity", "sds"])
@pytest.mark.parametrize("by", ["the method's weight", "the prior's weight"])
def test_albedo_can_be_switched_off(problem: Problem, scene: Scene, kind: str, by: str) -> None:
    mine = {"target_weight": 0.0, "kernel_weight": 0.0} if by == "the prior's weight" else {}
    changed = supervised(problem, kind=kind, **mine)
    settings = replace(SETTINGS, guided=False, weights=LossWeights() if mine else LossWeights(albedo=0.0))
    exact = noisy(scene)
    spoiled = ToldPrior(Noisy(), tuple(replace(view, albedo=view.albedo[::-1].copy()) for view in scene.train))
    assert same(fit(changed, exact, settings, Record()), fit(changed, spoiled, settings, Record()))


# ---- it helps --------------------------------------------------------------------------------------------------------


def test_kernel_does_not_mind_the_scale_of_a_view(problem: Problem, scene: Scene) -> None:
    """A prior whose albedo is exact up to a random scale per view is as good a kernel as the exact one, to float errors."""
    settings = replace(SETTINGS, guided=False, stage1_steps=30, pixels=256, weights=LossWeights(specular=0.0))
    changed = supervised(problem, kind="similarity", kernel_weight=1.0)
    errors = []
    for factor in (1.0, 0.5):
        random = np.random.default_rng(0)
        scales = np.exp(0.3 * random.standard_normal(6) - 1.0).astype(np.float32) if factor < 1 else np.ones(6, np.float32)
        views = tuple(replace(view, albedo=s * view.albedo) for view, s in zip(scene.train, scales, strict=True))
        prior = ToldPrior(OraclePrior(components=["albedo"]), views)
        errors.append(albedo_error(problem, scene, fit(changed, prior, settings, Record()).material.albedo))
    assert errors[1] == pytest.approx(errors[0], rel=0.01)


class Gaussian:
    """A distribution of albedo N(mean, 1) around a texture's picture, as a distiller sees it: noised and denoised."""

    info = PriorInfo(frozenset({"albedo"}), stochastic=True)

    def __init__(self, mean: Tensor) -> None:
        self._mean = mean

    def sample(self, *_: object, **__: object) -> Samples:
        raise AssertionError("a distiller is not sampled")

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        """E[x0 | x_t] of a Gaussian of variance 1: with noise of variance v, (mean v + x_t) / (1 + v), x_t = render + noise."""
        random = np.random.default_rng(seed)
        variance = float(np.exp(random.uniform(-2, 2)))
        assert observations.views is not None
        masks, render = observations.masks[..., None], renders["albedo"]
        noise = 0.05 * torch.from_numpy(random.standard_normal(render.shape).astype(np.float32)) * masks
        estimate = (variance * self._mean[list(observations.views)] + render + noise) / (1 + variance)
        return Samples({"albedo": estimate.clamp(0, 1) * (masks > 0)})


def test_distilled_gaussian_converges_to_its_mean(problem: Problem, scene: Scene) -> None:
    """Without an image loss nothing but the prior's mean is left: the albedo must become it, here a painted texture."""
    texture = 0.2 + 0.6 * torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(5))
    texture = texture.repeat_interleave(8, 0).repeat_interleave(8, 1)
    mean = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    prior = Gaussian(mean)
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
        ({"kind": "kernel"}, r"prior\.supervision\.kind: 'kernel'.*There are: target, similarity, sds"),
        ({"kernel_scale": 0.0}, r"prior\.supervision\.kernel_scale: expected 1e-06 or more, found 0\.0"),
        ({"radius": float("nan")}, r"prior\.supervision\.radius: .*found nan"),
        ({"target_weight": -1.0}, r"prior\.supervision\.target_weight: expected 0 or more, found -1\.0"),
        ({"sds_views": 0}, r"prior\.supervision\.sds_views: expected 1 or more, found 0"),
        ({"views": 0}, r"prior\.supervision\.views: expected 1 or more or auto, all, found 0"),
        ({"views": "some"}, r"prior\.supervision\.views: 'some'.* auto, all, a whole number"),
    ],
)
def test_impossible_settings(settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parsed(SupervisionSettings, settings, "prior.supervision")
