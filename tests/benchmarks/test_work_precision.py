"""Pure functions of the work-precision diagrams against closed forms and against drawn noise of known variance."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest
import torch

from benchmarks.work_precision.__main__ import main
from benchmarks.work_precision.inverse import BUDGETS, SPLITS, Setting
from benchmarks.work_precision.precision import Moments, converged, log_slope, relative_rmse, time_in_turns, without_compilation


@pytest.fixture(autouse=True)
def other_tests_as_before():
    """The command asks for deterministic algorithms, as a run does."""
    before = torch.are_deterministic_algorithms_enabled()
    yield
    torch.use_deterministic_algorithms(before)


def test_converged_knows_its_own_error():
    """The claimed standard error against the true one: 300 x 300 values, so 5 % is more than 10 of its deviations."""
    noise = np.random.default_rng(0).normal(size=(8, 300, 300))
    mean, error = converged(2 + noise)
    true = relative_rmse(mean, np.full((300, 300), 2.0))
    assert error == pytest.approx(1 / math.sqrt(8) / 2, rel=0.05)
    assert error == pytest.approx(true, rel=0.05)


def test_relative_variance_and_distance_have_no_bias_from_few_estimates():
    """3 estimates of 40 000 values, mean 1 and variance 4: a plain |mean|^2 would be 1 + 4/3 and the distance 8/3.

    Standard deviations of the tested means are below 0.02, so a bound of 0.1 is more than 5 of them (false alarms below
    1e-6); both biases are more than ten times the bound.
    """
    random = np.random.default_rng(0)
    one, other = Moments(), Moments()
    for _ in range(3):
        one.add(random.normal(1, 2, 40_000))
        other.add(random.normal(1, 2, 40_000))
    assert one.power / 40_000 == pytest.approx(1, abs=0.1)
    assert one.relative_variance == pytest.approx(4, abs=0.5)
    assert one.relative_distance(other) == pytest.approx(0, abs=0.1)


def test_log_slope_leaves_out_what_has_no_logarithm():
    assert log_slope([1, 2, 4, 8], [1.0, 0.5, 0.0, 0.125]) == pytest.approx(-1)


def test_without_compilation_replaces_the_time_of_the_first_steps():
    """Ten seconds of compiling in the first of 25 steps, then 0.1 s a step."""
    seconds = without_compilation([25, 50, 100], [12.5, 15.0, 20.0])
    assert seconds == pytest.approx([2.5, 5.0, 10.0])


def test_cases_are_timed_in_turns_without_their_warm_up():
    calls, results = [], []
    cases = {name: (lambda number, name=name: calls.append((name, number)) or number) for name in "ab"}
    times = time_in_turns(cases, rounds=2, warm_up=1, after=lambda name, result: results.append((name, result)))
    assert calls == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("a", 2), ("b", 2)]
    assert results == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]
    assert all(wall.shape == cpu.shape == (2,) for wall, cpu in times.values())


def test_every_way_of_dividing_a_budget_draws_as_many_samples():
    for budget in BUDGETS:
        drawn = {s.steps * s.pixels * s.samples for s in (Setting.of("none", split, budget) for split in SPLITS)}
        assert drawn == {budget * 4096 * 32}
        assert min(Setting.of("none", split, budget).steps for split in SPLITS) > 25, "the first score has to come earlier"


@pytest.mark.slow
def test_forward_command_writes_its_files_and_says_what_was_left_out(tmp_path, capsys):
    assert main(["--quick", "--only", "forward", "--scene", "tiny", "--out", str(tmp_path)]) == 0
    with (tmp_path / "forward.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_case = {row["case"]: float(row["relative_rmse"]) for row in rows if row["samples"] == "16"}
    assert by_case["MIS"] < by_case["BRDF"], "the light of this scene has a small bright sun"
    assert (tmp_path / "forward.png").stat().st_size > 10_000
    assert ("left out" in capsys.readouterr().out) == ("Mitsuba 3" not in by_case)


def test_an_unknown_scene_is_a_mistake_with_a_message(tmp_path, capsys):
    assert main(["--only", "forward", "--scene", "hta", "--out", str(tmp_path)]) == 2
    assert "hta" in capsys.readouterr().err
