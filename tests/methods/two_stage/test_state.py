"""A fit goes on from no state that it could not have written: every way of being wrong, each on a state that it did write."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_fit import Record, fit

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.none import NoPrior

SETTINGS = FitSettings(stage1_steps=6, stage2_steps=4, pixels=64, checkpoint_seconds=0.0)


def put(*place: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(state: dict[str, Any]) -> None:
        for key in place[:-1]:
            state = state[key]
        state[place[-1]] = value

    return change


@pytest.fixture(scope="module")
def written(problem: Problem) -> bytes:
    record = Record()
    fit(problem, NoPrior(), SETTINGS, record)
    return record.states[5]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("step", value=10_000), "state.step: expected 0 to 10, found 10000"),
        (put("step", value=-5), "state.step: expected 0 to 10, found -5"),
        (put("step", value=1.5), "state.step: expected a value of type int, found 1.5"),
        (put("step", value=True), "state.step: expected a value of type int, found True"),
        (lambda state: state.pop("generator"), "state: expected step, seconds, generator, "),
        (put("more", value=1), "state: expected step, seconds, generator, "),
        (put("generator", value=torch.zeros(16, dtype=torch.uint8)), r"state.generator: expected torch.uint8 \(5056,\)"),
        (put("parameters", "tensors", "albedo", value=torch.zeros(8, 8, 3)), r"albedo: expected torch.float32 \(64, 64, 3\)"),
        (put("parameters", "tensors", "albedo", value=torch.zeros(64, 64, 3).double()), r"found torch.float64 \(64, 64, 3\)"),
        (put("parameters", "optimizer", "state", 9, value={}), "optimizer.state: expected 0, 1, 2, found"),
        (put("parameters", "optimizer", "state", 2, value={}), "state.2: expected step, exp_avg, exp_avg_sq, found"),
        (put("parameters", "scale_ambiguity", "blocked", value="no"), "scale_ambiguity.blocked: expected a value of type int"),
        (put("dialogue", "counters", "network_calls", value=1.5), "counters: expected names, each with a value of type"),
        (put("seconds", value=[1.0, 2.0]), "state.seconds: expected prior, stage1, stage2, found"),
    ],
)
def test_what_the_fit_could_not_have_written_is_refused(
    problem: Problem, written: bytes, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    content = torch.load(io.BytesIO(written), weights_only=True)
    change(content["state"])
    file = io.BytesIO()
    torch.save(content, file)
    with pytest.raises(ValueError, match=message):
        fit(problem, NoPrior(), SETTINGS, Record(), resume=file.getvalue())


def test_a_state_without_its_targets_is_none(problem: Problem, written: bytes) -> None:
    content = torch.load(io.BytesIO(written), weights_only=True)
    file = io.BytesIO()
    torch.save({**content, "kept": {}}, file)
    with pytest.raises(ValueError, match="targets: expected values, weight, at_least, found None"):
        fit(problem, NoPrior(), SETTINGS, Record(), resume=file.getvalue())


def test_one_of_a_longer_fit_is_refused(problem: Problem, written: bytes) -> None:
    shorter = replace(SETTINGS, stage1_steps=3, stage2_steps=1)
    with pytest.raises(ValueError, match="state.step: expected 0 to 4, found 5"):
        fit(problem, NoPrior(), shorter, Record(), resume=written)
