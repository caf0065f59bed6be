"""The two-stage trainer on scene tiny, small: it starts where it should, recovers, repeats, and says what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Found, Record, albedo_error, altered, fit, make_problem, oracle, same

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.methods.contract import Monitor, PixelSamples, Problem
from ia_bench.methods.plan import Decision
from ia_bench.methods.two_stage.fit import TwoStageFit, initial_albedo
from ia_bench.methods.two_stage.metal import FEWEST, GAIN, look_for_metal
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import NoPrior
from ia_bench.scenes.scene import Scene


# ---- it recovers -----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def long_fits(problem: Problem, scene: Scene) -> dict[str, Found]:
    """The exact oracle and no prior, long enough to tell them apart."""
    settings = replace(SETTINGS, stage1_steps=120, stage2_steps=60, pixels=1024)
    return {"oracle": fit(problem, oracle(scene), settings, Record()), "none": fit(problem, NoPrior(), settings, Record())}


def test_exact_oracle_recovers_the_albedo(problem: Problem, scene: Scene, long_fits: dict[str, Found]) -> None:
    start = albedo_error(problem, scene, torch.full((64, 64, 3), 0.5))
    errors = {name: albedo_error(problem, scene, one.material.albedo) for name, one in long_fits.items()}
    assert errors["oracle"] < 0.3 * start
    assert errors["oracle"] < 0.5 * errors["none"]


def test_light_is_found_with_the_exact_oracle(scene: Scene, long_fits: dict[str, Found]) -> None:
    """Correlation with the true light in log radiance: what reflects from the object has to be where it was."""
    light = LatLongEnvironment(torch.from_numpy(scene.truth.lights["train"])).latlong(16)
    truth = np.log(light.numpy().mean(-1) + 1e-3).ravel()
    found = np.log(long_fits["oracle"].light.numpy().mean(-1) + 1e-3).ravel()
    assert np.corrcoef(truth, found)[0, 1] > 0.5


def test_l1_recovers_too(problem: Problem, scene: Scene, record: Record) -> None:
    settings = replace(SETTINGS, image_loss="l1", stage1_steps=60, stage2_steps=20, pixels=512)
    found = fit(problem, oracle(scene), settings, record)
    assert albedo_error(problem, scene, found.material.albedo) < 0.5 * albedo_error(problem, scene, torch.full((64, 64, 3), 0.5))


# ---- it repeats and resumes ------------------------------------------------------------------------------------------
def test_same_seed_same_numbers(problem: Problem, scene: Scene) -> None:
    results = []
    for seed in (0, 0, 1):
        torch.manual_seed(len(results))
        results.append(fit(problem, oracle(scene, noise=0.1), SETTINGS, Record(), seed))
    assert same(results[0], results[1])
    assert not same(results[0], results[2])


# ---- what goes wrong is said -----------------------------------------------------------------------------------------
def test_a_prior_that_was_asked_about_views_without_the_mesh_leaves_the_start_to_the_images(problem: Problem) -> None:
    expected = initial_albedo(problem, 0.5, None)
    images = problem.photographs.radiance
    nothing = PixelSamples({"albedo": torch.zeros_like(images)}, torch.zeros_like(images[:, :1]))
    assert torch.equal(initial_albedo(problem, 0.5, nothing), expected)
    assert float(expected.mean()) > 0.1


def test_the_start_explains_the_mean_image(problem: Problem) -> None:
    """With one constant light and albedo; the light is grey, but for the colour that the coat does not have."""
    made = TwoStageFit(altered(problem, prior=NoPrior()), SETTINGS, 0, Monitor.silent())
    made._start()
    material, light = made.parameters.recovered(final=True)
    assert torch.equal(light, light[:1, :1].expand(16, 32, 3))
    images = problem.renderer.render_images(problem.gbuffer, material, SampledLight.of(light), 32, torch.Generator().manual_seed(0))
    mean = np.stack([view.image for view in problem.scene.train]).mean((0, 1, 2))
    np.testing.assert_allclose(images["radiance"].numpy().mean((0, 1, 2)), mean, rtol=0.03)
    albedo, grey = material.albedo[0, 0].numpy(), light[0, 0].numpy()
    torch.testing.assert_close(material.albedo, material.albedo[:1, :1].expand_as(material.albedo))
    np.testing.assert_allclose(albedo / albedo.mean(), mean / mean.mean(), rtol=0.001)
    np.testing.assert_allclose(grey / grey.mean(), 1, rtol=0.1)


OF_METAL = FitSettings(stage1_steps=150, stage2_steps=50, pixels=1024, roughness_start=0.1)


@pytest.fixture(scope="module")
def half_metal(tiny: Scene) -> tuple[Problem, Material]:
    """Scene tiny with a golden metal on one half of the atlas, rendered by our renderer."""
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
    with_metal, without = Record(), Record()
    found = fit(altered(problem, plan=replace(problem.plan, metallic=True)), NoPrior(), OF_METAL, with_metal).material
    assert fit(problem, NoPrior(), OF_METAL, without).material.metallic is None
    hit = problem.gbuffer.face >= 0
    uv = problem.renderer.surface.uv(problem.gbuffer.face[hit].long(), problem.gbuffer.barycentric[hit])
    metal = fetch(truth.metallic, uv)[:, 0] > 0.5
    guess = fetch(found.metallic, uv)[:, 0]
    assert float(guess[metal].mean()) > float(guess[~metal].mean()) + 0.3
    assert sum(with_metal.losses[-20:]) < 0.9 * sum(without.losses[-20:])


def undecided(problem: Problem, notes: list[str]) -> Problem:
    """The problem as the plan leaves it where the scene's description does not say whether there is metal."""
    plan = replace(problem.plan, metallic=None, decisions=[Decision(None, "nobody says", what="render.metallic")])
    return altered(problem, plan=plan, note=notes.append)


def test_metal_is_found_by_photographs_held_out(half_metal: tuple[Problem, Material], problem: Problem) -> None:
    """The same object with one half of metal, and without: the plan says which, and shows the figures."""
    for asked, metal in ((half_metal[0], True), (problem, False)):
        look_for_metal(trial := undecided(asked, notes := []))
        (decision,) = trial.plan.decisions
        assert trial.plan.metallic is decision.value is metal
        assert decision.left_out == (None if metal else "a metallic texture")
        assert notes == [decision.line]
        without, by_metal = decision.measured.values()
        assert (by_metal - without >= GAIN) is metal
        assert f"{by_metal:.2f} dB" in notes[0]
        assert f"{without:.2f}" in notes[0]


def test_a_run_that_goes_on_decides_no_other_way(half_metal: tuple[Problem, Material], record: Record) -> None:
    notes: list[str] = []
    whole = fit(undecided(half_metal[0], notes), NoPrior(), SETTINGS, every_step := Record(every=0))
    again = fit(undecided(half_metal[0], notes), NoPrior(), SETTINGS, record, resume=every_step.states[12])
    assert same(whole, again)
    assert torch.equal(whole.material.metallic, again.material.metallic)
    assert len(notes) == 2
    assert len(set(notes)) == 1


def test_few_photographs_show_no_metal(half_metal: tuple[Problem, Material]) -> None:
    asked = undecided(half_metal[0], notes := [])
    few = replace(asked.scene, train=asked.scene.train[: FEWEST - 1])
    look_for_metal(trial := altered(asked, scene=few))
    assert trial.plan.metallic is False
    assert notes == ["plan: render.metallic = False: 5 photographs are too few to hold some out and see"]
