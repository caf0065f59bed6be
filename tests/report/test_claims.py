"""Verdicts on claimed orderings, against differences and intervals worked out by hand."""

from __future__ import annotations

import pytest
from scipy.stats import t as student
from scored_runs import scored

from ia_bench.report.claims import Outcome, Verdict, judge, tally
from ia_bench.report.collect import as_table
from ia_bench.report.table import carried_text
from ia_bench.runs.table import Claim

HAT = ["hat"]


def verdict(values: dict[str, dict[str, list[float]]], scenes: list[str] = HAT, metric: str = "albedo.psnr") -> Verdict:
    """On "ours above theirs"; ``values``: row -> scene -> score by seed."""
    runs = [
        scored(row, scene, seed, value)
        for row, found in values.items()
        for scene, seeds in found.items()
        for seed, value in enumerate(seeds)
    ]
    (found,) = judge(as_table(runs), [Claim("ours", "theirs", [metric])], scenes)
    return found


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ([22.0, 22.1, 21.9], [20.0, 20.1, 20.0], Outcome.REPRODUCED),
        ([20.0, 20.1, 20.0], [22.0, 22.1, 21.9], Outcome.NOT_REPRODUCED),
        ([22.0, 18.0, 20.5], [20.0, 20.1, 20.0], Outcome.UNDECIDED),
        ([22.0], [20.0], Outcome.UNDECIDED),  # no repetition, no interval
    ],
)
def test_outcome_is_where_the_interval_lies(ours: list[float], theirs: list[float], expected: Outcome) -> None:
    found = verdict({"ours": {"hat": ours}, "theirs": {"hat": theirs}})
    assert found.outcome is expected
    assert f"1 {expected.value}" in tally([found])


def test_differences_are_taken_seed_by_seed() -> None:
    """Seeds move both rows by much and their difference by little: only pairing tells them apart."""
    found = verdict({"ours": {"hat": [30.1, 20.2, 25.3]}, "theirs": {"hat": [30.0, 20.0, 25.0]}}).advantage
    assert found is not None
    assert found.mean == pytest.approx(0.2)
    assert found.half_width == pytest.approx(student.ppf(0.975, 2) * 0.1 / 3**0.5)


def test_only_runs_that_both_rows_have_count() -> None:
    found = verdict({"ours": {"hat": [22.0, 23.0], "ship": [50.0]}, "theirs": {"hat": [20.0], "console": [1.0]}}).advantage
    assert found is not None
    assert (found.mean, found.half_width, found.scenes) == (2.0, None, 1)
    assert verdict({"ours": {"hat": [22.0]}}).advantage is None


def test_a_missing_scene_leaves_it_undecided() -> None:
    """What survives of a row that failed elsewhere says nothing about the table."""
    values = {"ours": {"hat": [30.0, 30.1]}, "theirs": {"hat": [20.0, 20.1], "ship": [20.0, 20.1]}}
    assert verdict(values).outcome is Outcome.REPRODUCED
    assert verdict(values, ["hat", "ship"]).outcome is Outcome.UNDECIDED


def test_a_lower_error_is_an_advantage() -> None:
    found = verdict({"ours": {"hat": [0.010, 0.011, 0.012]}, "theirs": {"hat": [0.030, 0.031, 0.032]}}, metric="roughness.mse")
    assert found.advantage is not None
    assert found.advantage.mean == pytest.approx(0.02)
    assert found.outcome is Outcome.REPRODUCED


def test_a_claim_says_what_carries_it() -> None:
    found = verdict({"ours": {"hat": [20.23, 19.51, 21.56]}, "theirs": {"hat": [20.0, 20.0, 20.0]}})
    assert carried_text(found.pairs) == "seed 2 on hat"
    assert found.pairs.pairs["hat"][1] == pytest.approx(-0.49)
