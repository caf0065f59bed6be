"""Pure functions of the work-precision diagrams against closed forms and against drawn noise of known variance."""

import csv
import math

import numpy as np
import pytest
import torch

from benchmarks.work_precision.__main__ import main
from benchmarks.work_precision.precision import Moments, converged, relative_rmse


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


@pytest.mark.slow
def test_forward_command_writes_its_files_and_says_what_was_left_out(tmp_path, capsys):
    assert main(["--quick", "--scene", "tiny", "--out", str(tmp_path)]) == 0
    with (tmp_path / "forward.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_case = {row["case"]: float(row["relative_rmse"]) for row in rows if row["samples"] == "16"}
    assert by_case["MIS"] < by_case["BRDF"], "the light of this scene has a small bright sun"
    assert (tmp_path / "forward.png").stat().st_size > 10_000
    assert ("left out" in capsys.readouterr().out) == ("Mitsuba 3" not in by_case)
