"""The prior is asked as the paper says: once before each stage, the second time with renders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Found, Record, altered, fit, oracle, same
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings, LossWeights
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.none import NoPrior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.renderer import texture_images
from ia_bench.runs.truth import ToldPrior
from ia_bench.scenes.scene import Scene


class Asked(OraclePrior):
    """An oracle that remembers its questions."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.questions: list[tuple[int, Mapping[str, Tensor] | None]] = []

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        self.questions.append((seed, guidance))
        return super().sample(observations, seed=seed, guidance=guidance)


def asked(problem: Problem, scene: Scene, settings: FitSettings, **members: object) -> tuple[Asked, Found]:
    prior = Asked(noise=0.1)
    prior.info = replace(prior.info, **members)  # type: ignore[arg-type]
    return prior, fit(problem, ToldPrior(prior, scene.train), settings, Record(), seed=5)


def test_stage_two_is_guided_by_renders(problem: Problem, scene: Scene) -> None:
    prior, _ = asked(problem, scene, SETTINGS)
    assert [(seed, guidance is not None) for seed, guidance in prior.questions] == [(5, False), (5, True)]
    guidance = prior.questions[1][1]
    assert guidance is not None
    assert set(guidance) == {"albedo", "specular"}
    coverage = problem.gbuffer.coverage()
    for render in guidance.values():
        assert render.shape == (16, 32, 32, 3)
        assert bool((render >= 0).all())
        assert float(render[coverage == 0].abs().max()) == 0
    # The albedo that guides is the texture of that moment, seen from the training cameras.
    constant = replace(SETTINGS.rates, final=1.0)  # nothing of stage 1 may depend on the length of the whole
    settings = replace(SETTINGS, rates=constant, albedo_start=0.0, roughness_start=1.0, scale_ambiguity_start=0.0)
    whole, _ = asked(problem, scene, settings)
    half, found = asked(problem, scene, replace(settings, stage2_steps=0))
    assert len(half.questions) == 1
    picture = texture_images(problem.renderer.surface, problem.gbuffer, found.material.albedo)
    guide = whole.questions[1][1]
    assert guide is not None
    torch.testing.assert_close(guide["albedo"], picture, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("changes", "members"), [({"guided": False}, {}), ({}, {"guidable": False})])
def test_no_second_draw_without_guidance(problem: Problem, scene: Scene, changes: dict, members: dict) -> None:
    prior, _ = asked(problem, scene, replace(SETTINGS, **changes), **members)
    assert [guidance for _, guidance in prior.questions] == [None]


@pytest.mark.parametrize(
    ("weights", "specular_weight", "guided"),
    [
        ({}, 0.0, {"albedo"}),
        ({"specular": 0.0}, 1.0, {"albedo"}),
        ({"albedo": 0.0}, 1.0, {"specular"}),
        ({"albedo": 0.0}, 0.0, None),
    ],
)
def test_what_has_no_weight_guides_nothing_and_is_not_asked(
    problem: Problem, scene: Scene, weights: dict, specular_weight: float, guided: set[str] | None
) -> None:
    """An ablated component must not come back through the samples of the other one."""
    changed = altered(problem, supervision=SupervisionSettings(specular_weight=specular_weight))
    prior, _ = asked(changed, scene, replace(SETTINGS, weights=LossWeights(**weights)))
    expected = [] if guided is None else [None, guided]
    assert [guidance and set(guidance) for _, guidance in prior.questions] == expected


def test_weights_switch_components_off(problem: Problem, scene: Scene) -> None:
    """Without a component's weight its sample has no influence; the ablation rows of the table rest on this."""
    for name in ("albedo", "specular"):
        settings = replace(SETTINGS, guided=False, weights=LossWeights(**{name: 0.0}))
        exact = fit(problem, oracle(scene), settings, Record())
        views = tuple(replace(view, **{name: 0.1 * getattr(view, name)}) for view in scene.train)
        noisy = ToldPrior(OraclePrior(), views)
        assert same(exact, fit(problem, noisy, settings, Record()))
        assert not same(exact, fit(problem, noisy, replace(settings, weights=LossWeights()), Record()))


def test_roughness_waits(problem: Problem) -> None:
    settings = replace(SETTINGS, checkpoint_seconds=0.0, roughness_start=0.5)
    record = Record()
    fit(problem, NoPrior(), settings, record)
    states = {step: record.monitor(state).load() for step, state in record.states.items()}
    roughness = {step: state["parameters"]["tensors"]["roughness"] for step, state in states.items() if state is not None}
    assert bool((roughness[15] == settings.roughness_initial).all())
    assert not torch.equal(roughness[16], roughness[15])


def test_the_start_explains_the_mean_image(problem: Problem, record: Record) -> None:
    """With one constant light and albedo; the light is grey, but for the colour that the coat does not have."""
    found = fit(problem, NoPrior(), replace(SETTINGS, stage1_steps=0, stage2_steps=0), record)
    assert torch.equal(found.light, found.light[:1, :1].expand(16, 32, 3))
    generator = torch.Generator().manual_seed(0)
    images = problem.renderer.render_images(problem.gbuffer, found.material, SampledLight.of(found.light), 32, generator)
    mean = np.stack([view.image for view in problem.scene.train]).mean((0, 1, 2))
    np.testing.assert_allclose(images["radiance"].numpy().mean((0, 1, 2)), mean, rtol=0.03)
    albedo, light = found.material.albedo[0, 0].numpy(), found.light[0, 0].numpy()
    torch.testing.assert_close(found.material.albedo, found.material.albedo[:1, :1].expand_as(found.material.albedo))
    np.testing.assert_allclose(albedo / albedo.mean(), mean / mean.mean(), rtol=0.001)
    np.testing.assert_allclose(light / light.mean(), 1, rtol=0.1)
