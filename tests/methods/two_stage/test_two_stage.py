"""The two-stage trainer on scene tiny: it recovers, repeats, resumes to the same bits, and says what goes wrong.

Small (16 samples, 64 texels, tens of steps): the numbers say that learning happens, not how good it gets.
"""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Found, Record, albedo_error, fit, make_problem, oracle, same

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.none import NoPrior
from ia_bench.scenes.scene import Scene

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
    light = LatLongEnvironment(torch.from_numpy(scene.truth.lights["train"])).latlong(16)
    truth = np.log(light.numpy().mean(-1) + 1e-3).ravel()
    found = np.log(long_fits["oracle"].light.numpy().mean(-1) + 1e-3).ravel()
    assert np.corrcoef(truth, found)[0, 1] > 0.5


def test_l1_recovers_too(problem: Problem, scene: Scene, record: Record) -> None:
    settings = replace(SETTINGS, image_loss="l1", stage1_steps=60, stage2_steps=20, pixels=512)
    found = fit(problem, oracle(scene), settings, record)
    assert albedo_error(problem, scene, found.material.albedo) < 0.5 * albedo_error(problem, scene, torch.full((64, 64, 3), 0.5))


# ---- it repeats and resumes ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["guided", "unguided", "l1"])
def uninterrupted(request: pytest.FixtureRequest, problem: Problem, scene: Scene) -> tuple[Found, Record, FitSettings]:
    """A whole fit that has kept its state after every step."""
    changes = {"guided": {}, "unguided": {"guided": False}, "l1": {"image_loss": "l1"}}[request.param]
    settings, record = replace(SETTINGS, **changes), Record(every=0.0)
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
    assert record.notes == [f"resumed at step {step} of 30 (stage{1 if step <= 20 else 2})"]
    assert [score[:2] for score in record.scores] == [score[:2] for score in kept.scores if score[1] > step]
    assert resumed.seconds["stage1"] > 0


def test_same_seed_same_numbers(problem: Problem, scene: Scene) -> None:
    results = []
    for seed in (0, 0, 1):
        torch.manual_seed(len(results))
        results.append(fit(problem, oracle(scene, noise=0.1), SETTINGS, Record(), seed))
    assert same(results[0], results[1])
    assert not same(results[0], results[2])


# ---- what goes wrong is said -----------------------------------------------------------------------------------------


def test_nan_in_an_image_stops_with_the_view(scene: Scene, record: Record) -> None:
    blind = scene.blind()
    image = blind.train[2].image.copy()
    image[5, 6, 1] = np.nan
    spoiled = replace(blind, train=(*blind.train[:2], replace(blind.train[2], image=image), *blind.train[3:]))
    with pytest.raises(FloatingPointError, match=f"^training view {blind.train[2].name}: the image is NaN or Inf in 1 of "):
        fit(make_problem(spoiled), NoPrior(), SETTINGS, record)


@pytest.mark.parametrize("spoil", ["list", "empty", "no samples", "size"])
def test_a_checkpoint_of_something_else_raises_before_a_step(problem: Problem, scene: Scene, spoil: str) -> None:
    """A run then starts over, as it does for whatever raises before there is a bar of progress."""
    whole, settings = Record(every=0.0), replace(SETTINGS, stage1_steps=3, stage2_steps=0)
    fit(problem, oracle(scene), settings, whole)
    content = torch.load(io.BytesIO(whole.states[2]), weights_only=True)
    if spoil == "no samples":
        del content["parts"]["prior"]
    elif spoil == "size":
        content["parts"]["parameters"]["albedo"] = torch.zeros(8, 8, 3)
    else:
        content = [1] if spoil == "list" else {}
    file, record = io.BytesIO(), Record()
    torch.save(content, file)
    with pytest.raises((TypeError, KeyError, ValueError)):
        fit(problem, oracle(scene), settings, record, resume=file.getvalue())
    assert not record.losses
