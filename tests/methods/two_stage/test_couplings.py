"""The prior in whole fits: asked as the paper says, coupled as the run says, and resumed to the same bits."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from small_fit import Found, Record, altered, coupled, fit, make_problem, regularised, same
from torch import Tensor

from ia_bench.methods.contract import Coupling, NoCoupling, PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.kernel import Kernel
from ia_bench.methods.couplings.targets import Distilled, Targets
from ia_bench.methods.two_stage.settings import FitSettings, LossWeights
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.renderer import texture_images
from ia_bench.runs.scene import ToldPrior
from ia_bench.scenes.scene import Scene

SETTINGS = FitSettings(stage1_steps=6, stage2_steps=4, pixels=128)
DISTILLED = Distilled(period=3, views=2)

CASES: dict[str, tuple[Coupling, int | str, FitSettings]] = {
    "targets": (Targets(), "all", SETTINGS),
    "kernel": (Kernel(), "all", SETTINGS),
    "few views": (Targets(), 3, SETTINGS),
    "regularised": (Targets(), "all", regularised(SETTINGS, parsimony={}, context={}, symmetry={})),
    "distilled": (DISTILLED, "all", SETTINGS),
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
        self.guidance: Mapping[str, Tensor] = {}

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        self.asked.append(("sample" if guidance is None else "guided", len(observations.images), seed))
        self.guidance = guidance or {}
        samples = super().sample(observations, seed=seed, guidance=guidance)
        return replace(samples, cost={"network_calls": 10, "distilled": 0})

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        views = len(observations.images)
        self.asked.append(("distill", views, seed))
        level, truth = np.random.default_rng(seed).uniform(0.2, 0.8), observations.truth
        values = {name: level * truth[name] + (1 - level) * render for name, render in renders.items()}
        return Samples(values, cost={"network_calls": 1, "distilled": views})


def noisy(scene: Scene, **members: object) -> tuple[Noisy, ToldPrior]:
    prior = Noisy()
    prior.info = replace(prior.info, **members)  # type: ignore[arg-type]
    return prior, ToldPrior(prior, lambda: scene.train)


def questions(prior: Noisy) -> list[tuple[str, int]]:
    return [(what, views) for what, views, _ in prior.asked]


# ---- it resumes ------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module", params=CASES)
def uninterrupted(request: pytest.FixtureRequest, problem: Problem, scene: Scene) -> tuple[Found, Record, Problem, FitSettings]:
    """A whole fit that has kept its state after every step."""
    (coupling, views, settings), record = CASES[request.param], Record(every=0.0)
    changed = coupled(problem, coupling, prior_views=views)
    return fit(changed, noisy(scene)[1], settings, record), record, changed, settings


@pytest.mark.parametrize("step", [4, 6, 8], ids=["in stage 1", "at the boundary", "in stage 2"])
def test_resumed_fit_ends_with_the_same_bits(
    uninterrupted: tuple[Found, Record, Problem, FitSettings], step: int, scene: Scene, record: Record
) -> None:
    whole, kept, changed, settings = uninterrupted
    torch.manual_seed(1234)
    resumed = fit(changed, noisy(scene)[1], settings, record, resume=kept.states[step])
    assert record.losses == kept.losses[step:]
    assert same(resumed, whole)
    assert resumed.counters == whole.counters  # what was spent before the interruption counts


# ---- the prior is asked as the paper says ----------------------------------------------------------------------------
def test_stage_two_is_guided_by_renders(problem: Problem, scene: Scene) -> None:
    """The albedo that guides is the texture of that moment, seen from the training cameras."""
    constant = replace(SETTINGS.rates, final=1.0)  # nothing of stage 1 may depend on the length of the whole
    settings = replace(SETTINGS, rates=constant, albedo_start=0.0, roughness_start=1.0, scale_ambiguity_start=0.0)
    prior, told = noisy(scene)
    found = fit(altered(problem, prior_views=4), told, SETTINGS, Record(), seed=5)
    assert prior.asked == [("sample", 4, 5), ("guided", 4, 5)]
    steps = {"regularisers_clamped": 0, "skipped_steps": 0, "scale_ambiguity_blocked_steps": 0, "samples_per_pixel": 16}
    assert found.counters == {"network_calls": 20, "prior_cached": 0, "prior_absurd_values": 0, "distilled": 0, **steps}
    prior, told = noisy(scene)
    fit(problem, told, settings, Record())
    assert set(prior.guidance) == {"albedo", "specular"}
    for render in prior.guidance.values():
        assert render.shape == (6, 32, 32, 3)
        assert bool((render >= 0).all())
        assert float(render[problem.gbuffer.coverage() == 0].abs().max()) == 0
    half = fit(problem, noisy(scene)[1], replace(settings, stage2_steps=0), Record())
    picture = texture_images(problem.renderer.surface, problem.gbuffer, half.material.albedo)
    torch.testing.assert_close(prior.guidance["albedo"], picture, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("coupling", "guided"),
    [
        (Kernel(), {"albedo"}),  # specular shading is of weight 0
        (Targets(specular=0.0), {"albedo"}),
        (Targets(albedo=0.0), {"specular"}),
        (Targets(albedo=0.0, specular=0.0), None),
        (NoCoupling(), None),
    ],
)
def test_what_has_no_weight_is_never_asked(problem: Problem, scene: Scene, coupling: Coupling, guided: set[str] | None) -> None:
    """An ablated component must not come back through the samples of the other one."""
    prior, told = noisy(scene)
    fit(coupled(problem, coupling), told, SETTINGS, Record())
    assert questions(prior) == ([] if guided is None else [("sample", 6), ("guided", 6)])
    assert set(prior.guidance) == (guided or set())


def test_distillation_follows_its_period(problem: Problem, scene: Scene) -> None:
    prior, told = noisy(scene)
    found = fit(coupled(problem, DISTILLED, prior_views=4), told, SETTINGS, Record())
    assert questions(prior) == [("distill", 2)] * 4  # steps 0, 3, 6, 9
    assert len({seed for *_, seed in prior.asked}) == 4
    assert (found.counters["network_calls"], found.counters["distilled"]) == (4, 8)
    assert found.seconds["prior"] > 0


# ---- it helps --------------------------------------------------------------------------------------------------------
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
        masks, render = observations.masks[..., None], renders["albedo"]
        noise = 0.05 * torch.from_numpy(random.standard_normal(render.shape).astype(np.float32)) * masks
        estimate = (variance * self._mean[list(observations.views)] + render + noise) / (1 + variance)
        return Samples({"albedo": estimate.clamp(0, 1) * (masks > 0)})


def test_distilled_gaussian_converges_to_its_mean(problem: Problem) -> None:
    """Without an image loss nothing but the prior's mean is left: the albedo must become it, here a painted texture."""
    texture = 0.2 + 0.6 * torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(5))
    texture = texture.repeat_interleave(8, 0).repeat_interleave(8, 1)
    mean = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    weights: Any = LossWeights(image=0.0, smooth_albedo=0.0, smooth_roughness=0.0)
    settings = replace(SETTINGS, stage1_steps=120, stage2_steps=0, pixels=512, albedo_start=0.0, weights=weights)
    found = fit(coupled(problem, Distilled(period=3, views=4)), Gaussian(mean), settings, Record()).material.albedo
    inner = (problem.gbuffer.face >= 0).all(1)

    def distance(albedo: Tensor) -> float:
        seen = problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, albedo))
        return float((seen - problem.pixels_of(mean))[inner].abs().mean())

    assert distance(found) < 0.15 * distance(torch.full_like(texture, SETTINGS.albedo_initial))


# ---- what a plug-in may do -------------------------------------------------------------------------------------------
class Named(Coupling):
    """A loss of nothing under any name."""

    def __init__(self, name: str = "mine") -> None:
        self.name = name

    def prepare(self, samples: PixelSamples, problem: Problem) -> None: ...

    def loss(self, render: StepRender, pixels: Tensor) -> dict[str, Tensor]:
        return {self.name: 0 * render.albedo.mean()}


def test_a_coupling_names_its_losses_as_it_likes(problem: Problem, scene: Scene) -> None:
    mine, image = (fit(coupled(problem, Named(name)), noisy(scene)[1], SETTINGS, Record()) for name in ("mine", "image"))
    assert same(mine, image)
