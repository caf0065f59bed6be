"""The two-stage trainer on scene tiny: it recovers, repeats, resumes to the same bits, and sees no truth.

Small (16 samples, 64 texels, tens of steps): the numbers say that learning happens, not how good it gets.
"""

from __future__ import annotations

import io
import types
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_fit import Found, Record, altered, fit, make_problem, same
from torch import Tensor

from ia_bench.common.progress import Progress
from ia_bench.light.latlong import SampledLight, resize_light
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.ceiling import Ceiling
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.info import MethodInfo
from ia_bench.methods.plan import make_plan
from ia_bench.methods.two_stage.fit import FIRST_SCORE
from ia_bench.methods.two_stage.settings import FitSettings, LossWeights
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.none import NoPrior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render import renderer as renderer_module
from ia_bench.render.renderer import texture_images
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.run import run
from ia_bench.runs.truth import ToldPrior
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene

SETTINGS = FitSettings(stage1_steps=20, stage2_steps=10, pixels=256, checkpoint_seconds=1e9)


def oracle(scene: Scene, **dials: Any) -> ToldPrior:
    return ToldPrior(OraclePrior(**dials), scene.train)


def albedo_error(problem: Problem, scene: Scene, albedo: Tensor) -> float:
    """RMS of sRGB albedo over the training views' inner pixels, after one scale for the scene has made means equal."""
    picture = texture_images(problem.renderer.surface, problem.gbuffer, albedo).numpy()
    truth = np.stack([view.albedo for view in scene.train])
    inside = np.stack([view.mask for view in scene.train]) > 0.99
    picture, truth = picture[inside], truth[inside]
    aligned = picture * (truth.mean() / picture.mean())
    return float(np.sqrt(((linear_to_srgb(aligned.clip(0, 1)) - linear_to_srgb(truth)) ** 2).mean()))


# ---- it recovers -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def long_fits(problem: Problem, scene: Scene) -> dict[str, Found]:
    """The exact oracle and no prior, long enough to tell them apart."""
    settings = replace(SETTINGS, stage1_steps=120, stage2_steps=60, pixels=1024)
    return {
        "oracle": fit(problem, oracle(scene), settings, Record()),
        "none": fit(problem, NoPrior(), settings, Record()),
    }


def test_exact_oracle_recovers_the_albedo(problem: Problem, scene: Scene, long_fits: dict[str, Found]) -> None:
    start = albedo_error(problem, scene, torch.full((64, 64, 3), 0.5))
    errors = {name: albedo_error(problem, scene, one.material.albedo) for name, one in long_fits.items()}
    assert errors["oracle"] < 0.3 * start
    assert errors["oracle"] < 0.5 * errors["none"]


def test_result_is_valid(long_fits: dict[str, Found]) -> None:
    for one in long_fits.values():
        assert one.material.albedo.shape == (64, 64, 3)
        assert one.material.roughness.shape == (64, 64, 1)
        assert one.light.shape == (16, 32, 3)
        assert 0 <= one.material.albedo.min() <= one.material.albedo.max() <= 1
        assert 0 < one.material.roughness.min() <= one.material.roughness.max() <= 1
        assert bool(torch.isfinite(one.light).all() & (one.light > 0).all())
        assert not one.material.albedo.requires_grad
        assert set(one.seconds) == {"prior", "stage1", "stage2"}
        assert min(one.seconds.values()) >= 0


def test_light_is_found_with_the_exact_oracle(scene: Scene, long_fits: dict[str, Found]) -> None:
    """Correlation with the true light in log radiance: what reflects from the object has to be where it was."""
    truth = np.log(resize_light(scene.truth.lights["train"], 16).mean(-1) + 1e-3).ravel()
    found = np.log(long_fits["oracle"].light.numpy().mean(-1) + 1e-3).ravel()
    assert np.corrcoef(truth, found)[0, 1] > 0.5


def test_l1_recovers_too(problem: Problem, scene: Scene, record: Record) -> None:
    settings = replace(SETTINGS, image_loss="l1", stage1_steps=60, stage2_steps=20, pixels=512)
    found = fit(problem, oracle(scene), settings, record)
    assert albedo_error(problem, scene, found.material.albedo) < 0.5 * albedo_error(
        problem, scene, torch.full((64, 64, 3), 0.5)
    )


# ---- it repeats and resumes ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["guided", "unguided", "l1"])
def uninterrupted(request: pytest.FixtureRequest, problem: Problem, scene: Scene) -> tuple[Found, Record, FitSettings]:
    """A whole fit that has kept its state after every step."""
    changes = {"guided": {}, "unguided": {"guided": False}, "l1": {"image_loss": "l1"}}[request.param]
    settings = replace(SETTINGS, checkpoint_seconds=0.0, **changes)
    record = Record()
    return fit(problem, oracle(scene, noise=0.1, scale=0.2), settings, record), record, settings


@pytest.mark.parametrize("step", [7, 20, 26], ids=["in stage 1", "at the boundary", "in stage 2"])
def test_resumed_fit_ends_with_the_same_bits(
    uninterrupted: tuple[Found, Record, FitSettings], step: int, problem: Problem, scene: Scene, record: Record
) -> None:
    whole, kept, settings = uninterrupted
    torch.manual_seed(1234)  # the global generator has moved on when a run is resumed
    prior = oracle(scene, noise=0.1, scale=0.2)
    resumed = fit(problem, prior, settings, record, resume=kept.states[step])
    assert len(record.losses) == 30 - step
    assert record.losses == kept.losses[step:]
    assert same(resumed, whole)
    assert record.notes == [f"resumed at step {step} of 30"]
    assert [score[:2] for score in record.scores] == [score[:2] for score in kept.scores if score[1] > step]
    assert resumed.seconds["stage1"] > 0


def test_interrupted_twice(problem: Problem, scene: Scene) -> None:
    settings = replace(SETTINGS, checkpoint_seconds=0.0)
    whole, first, second = Record(), Record(), Record()
    expected = fit(problem, oracle(scene, noise=0.1), settings, whole)
    fit(problem, oracle(scene, noise=0.1), settings, first, resume=whole.states[5])
    found = fit(problem, oracle(scene, noise=0.1), settings, second, resume=first.states[23])
    assert same(found, expected)


def test_states_are_kept_by_time(problem: Problem) -> None:
    every, never = Record(), Record()
    fit(problem, NoPrior(), replace(SETTINGS, checkpoint_seconds=0.0), every)
    fit(problem, NoPrior(), SETTINGS, never)
    assert sorted(every.states) == list(range(1, 30))  # a finished fit needs none
    assert never.states == {}


def test_same_seed_same_numbers(problem: Problem, scene: Scene) -> None:
    results = []
    for seed in (0, 0, 1):
        torch.manual_seed(len(results))
        results.append(fit(problem, oracle(scene, noise=0.1), SETTINGS, Record(), seed))
    assert same(results[0], results[1])
    assert not same(results[0], results[2])


def test_scores_come_at_doubling_steps(problem: Problem, record: Record) -> None:
    fit(problem, NoPrior(), replace(SETTINGS, stage1_steps=60, stage2_steps=60, pixels=32), record)
    assert [(stage, step) for stage, step, _ in record.scores] == [
        ("stage1", FIRST_SCORE), ("stage1", 2 * FIRST_SCORE), ("stage2", 4 * FIRST_SCORE)
    ]  # fmt: skip
    seconds = [second for *_, second in record.scores]
    assert seconds == sorted(seconds)
    assert len(record.losses) == 120


# ---- the prior is asked as the paper says ----------------------------------------------------------------------------


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
    settings = replace(SETTINGS, rates=constant, albedo_start=0.0, roughness_start=1.0, exchange_start=0.0)
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
def test_what_has_no_weight_guides_nothing(
    problem: Problem, scene: Scene, weights: dict, specular_weight: float, guided: set[str] | None
) -> None:
    """An ablated component must not come back through the samples of the other one."""
    changed = altered(problem, supervision=SupervisionSettings(specular_weight=specular_weight))
    prior, _ = asked(changed, scene, replace(SETTINGS, weights=LossWeights(**weights)))
    expected = [None] if guided is None else [None, guided]
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


# ---- what goes wrong is said -----------------------------------------------------------------------------------------


def test_nan_in_an_image_stops_with_the_view(scene: Scene, record: Record) -> None:
    blind = scene.blind()
    image = blind.train[2].image.copy()
    image[5, 6, 1] = np.nan
    spoiled = replace(blind, train=(*blind.train[:2], replace(blind.train[2], image=image), *blind.train[3:]))
    with pytest.raises(FloatingPointError, match=f"^training view {blind.train[2].name}: NaN or Inf in 1 values of the image"):
        fit(make_problem(spoiled), NoPrior(), SETTINGS, record)


# ---- it sees no truth ------------------------------------------------------------------------------------------------


def trap(allowed: dict[str, Any], what: str) -> types.SimpleNamespace:
    """An object with these attributes alone; reading any other one fails the test."""

    class Trap(types.SimpleNamespace):
        def __getattr__(self, name: str) -> Any:
            raise AssertionError(f"training read {what}.{name}")

    return Trap(**allowed)


def test_training_sees_images_masks_and_cameras_alone(scene: Scene, record: Record) -> None:
    views = tuple(
        trap({"name": v.name, "camera": v.camera, "image": v.image, "mask": v.mask, "light": v.light}, "view")
        for v in scene.train
    )
    told = {"name": scene.name, "source": scene.source, "mesh": scene.mesh, "notes": (), "metallic": scene.metallic}
    blind = trap({**told, "train": views}, "scene")
    with pytest.raises(AssertionError, match="training read view.albedo"):
        _ = views[0].albedo
    with pytest.raises(AssertionError, match="training read scene.truth"):
        _ = blind.truth
    trapped = make_problem(blind)  # type: ignore[arg-type]
    plan = make_plan(blind, Stage(scene.mesh, torch.device("cpu")), RenderSettings(), NoPrior())  # type: ignore[arg-type]
    assert plan.decisions
    found = fit(trapped, oracle(scene, noise=0.1), SETTINGS, record)
    expected = fit(make_problem(scene.blind()), oracle(scene, noise=0.1), SETTINGS, Record())
    assert same(found, expected)


class Reached(Exception):
    """Carries what a method was given out of run.py."""


class Spying(Ceiling):
    """A method that stops the run and shows what it was given."""

    info = MethodInfo(uses_prior=True)

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        raise Reached(problem)


def test_run_hands_a_method_a_blind_scene(tmp_path: Path) -> None:
    config = compose(["scene=tiny", "preset=smoke", "device=cpu", "threads=1", f"method={__name__}:Spying"])
    folder, progress = RunFolder.open(tmp_path / "run", {}, "0"), Progress(io.StringIO())
    with folder, progress, pytest.raises(Reached) as reached:
        run(config, folder, progress)
    (problem,) = reached.value.args
    assert problem.truth is None
    assert (problem.scene.truth, problem.scene.test, problem.scene.novel) == (None, (), ())
    assert {view.albedo is None and view.specular is None for view in problem.scene.train} == {True}
    assert not {"stage", "plan", "gbuffer", "renderer", "prior"} & vars(problem).keys() - {"stage"}  # nothing is made unasked
    assert isinstance(problem.prior, NoPrior)


@pytest.mark.parametrize(
    ("image_loss", "samples", "taken"),
    [
        ("crossed", 24, 32),
        ("crossed", 8, 16),
        ("l1", 24, 24),
        ("l1", 1, 8),
    ],
)
def test_samples_are_those_that_the_renderer_takes(
    problem: Problem, image_loss: str, samples: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of pixels with 2 x 2 points; a step draws as many as the record says."""
    assert problem.gbuffer.subsamples == 4
    drawn = []
    original = renderer_module.draw_samples

    def spy(*arguments: object, points: int, count: int, **parts: int) -> object:
        drawn.append(2 * points * count)
        return original(*arguments, points=points, count=count, **parts)

    monkeypatch.setattr(renderer_module, "draw_samples", spy)
    settings = replace(SETTINGS, stage1_steps=1, stage2_steps=0, image_loss=image_loss, albedo_start=0.0)
    record = Record()
    found = fit(altered(problem, plan=replace(problem.plan, samples=samples)), NoPrior(), settings, record)
    assert found.counters["samples_per_pixel"] == taken
    assert drawn[-1] * (2 if image_loss == "crossed" else 1) == taken
    assert (f"render.samples={samples}: steps take {taken} a pixel" in " ".join(record.notes)) == (samples != taken)


def test_a_resumed_run_costs_what_both_parts_did(tmp_path: Path) -> None:
    """Killed after some steps: rays and points of the whole are counted once, and the seconds before count too."""
    config = compose(["scene=tiny", "preset=smoke", "device=cpu", "threads=1", "prior=oracle", "fit.checkpoint_seconds=0"])

    def costs(folder: RunFolder) -> tuple[int, int, bool]:
        metrics = run(config, folder, Progress(io.StringIO()))
        return metrics["rays"], metrics["counters"]["points"], metrics["time_s"]["total"] > slept

    slept = 1000.0  # seconds more than the first process says that it took

    class Killed(BaseException):
        pass

    class Dying(RunFolder):
        def save_checkpoint(self, state: dict[str, Any]) -> None:
            super().save_checkpoint({**state, "books": {**state["books"], "total": state["books"]["total"] + slept}})
            if state["method"]["step"] == 7:
                raise Killed

    with RunFolder.open(tmp_path / "whole", {}, "0") as folder:
        rays, points, _ = costs(folder)
    with Dying.open(tmp_path / "killed", {}, "0") as folder, pytest.raises(Killed):
        costs(folder)
    with RunFolder.open(tmp_path / "killed", {}, "0") as folder:
        assert costs(folder) == (rays, points, True)


def test_blind_leaves_nothing_else(scene: Scene) -> None:
    blind = scene.blind()
    assert (blind.truth, blind.test, blind.novel) == (None, (), ())
    assert scene.truth is not None
    assert all(view.albedo is not None for view in scene.train)
    for view in blind.train:
        assert [view.albedo, view.specular, view.roughness, view.normal, view.depth] == [None] * 5
