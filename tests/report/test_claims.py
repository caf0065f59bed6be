"""Verdicts on claimed orderings, against differences and intervals worked out by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import t as student

from ia_bench.report.claims import Outcome, judge
from ia_bench.report.collect import Run, read_run
from ia_bench.report.table import carried_text
from ia_bench.runs.table import Claim

Write = Callable[..., Path]
PSNR = ["albedo.psnr"]
HAT = ["hat"]


def runs_of(write_run: Write, values: dict[str, dict[str, list[float]]]) -> list[Run]:
    """Row -> scene -> PSNR by seed."""
    return [
        read_run(write_run(row, scene, seed, psnr=value))
        for row, scenes in values.items()
        for scene, seeds in scenes.items()
        for seed, value in enumerate(seeds)
    ]


def outcome(write_run: Write, ours: list[float], theirs: list[float]) -> Outcome:
    runs = runs_of(write_run, {"ours": {"hat": ours}, "theirs": {"hat": theirs}})
    return judge(runs, [Claim("ours", "theirs", PSNR)], HAT)[0].outcome


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ([22.0, 22.1, 21.9], [20.0, 20.1, 20.0], Outcome.REPRODUCED),
        ([20.0, 20.1, 20.0], [22.0, 22.1, 21.9], Outcome.NOT_REPRODUCED),
        ([22.0, 18.0, 20.5], [20.0, 20.1, 20.0], Outcome.UNDECIDED),
        ([22.0], [20.0], Outcome.UNDECIDED),  # no repetition, no interval
    ],
)
def test_outcome_is_where_the_interval_lies(
    write_run: Write, ours: list[float], theirs: list[float], expected: Outcome
) -> None:
    assert outcome(write_run, ours, theirs) is expected


def test_differences_are_taken_seed_by_seed(write_run: Write) -> None:
    """Seeds move both rows by much and their difference by little: only pairing tells them apart."""
    runs = runs_of(write_run, {"ours": {"hat": [30.1, 20.2, 25.3]}, "theirs": {"hat": [30.0, 20.0, 25.0]}})
    found = judge(runs, [Claim("ours", "theirs", PSNR)], HAT)[0].advantage
    assert found is not None
    assert found.mean == pytest.approx(0.2)
    assert found.half_width == pytest.approx(student.ppf(0.975, 2) * 0.1 / 3**0.5)


def test_only_runs_that_both_rows_have_count(write_run: Write) -> None:
    runs = runs_of(write_run, {"ours": {"hat": [22.0, 23.0], "ship": [50.0]}, "theirs": {"hat": [20.0], "console": [1.0]}})
    found = judge(runs, [Claim("ours", "theirs", PSNR)], HAT)[0].advantage
    assert found is not None
    assert (found.mean, found.half_width, found.scenes) == (2.0, None, 1)
    assert judge(runs, [Claim("ours", "nobody", PSNR)], HAT)[0].advantage is None


def test_a_missing_scene_leaves_it_undecided(write_run: Write) -> None:
    """What survives of a row that failed elsewhere says nothing about the table."""
    runs = runs_of(write_run, {"ours": {"hat": [30.0, 30.1]}, "theirs": {"hat": [20.0, 20.1], "ship": [20.0, 20.1]}})
    claim = Claim("ours", "theirs", PSNR)
    assert judge(runs, [claim], HAT)[0].outcome is Outcome.REPRODUCED
    assert judge(runs, [claim], ["hat", "ship"])[0].outcome is Outcome.UNDECIDED


def test_a_lower_error_is_an_advantage(write_run: Write) -> None:
    runs = []
    for row, error in (("ours", 0.01), ("theirs", 0.03)):
        for seed in range(3):
            run = read_run(write_run(row, "hat", seed))
            runs.append(replace(run, metrics={**run.metrics, "roughness.mse": error + 0.001 * seed}))
    verdict = judge(runs, [Claim("ours", "theirs", ["roughness.mse"])], HAT)[0]
    assert verdict.advantage is not None
    assert verdict.advantage.mean == pytest.approx(0.02)
    assert verdict.outcome is Outcome.REPRODUCED


def test_an_unknown_metric_is_named(write_run: Write) -> None:
    with pytest.raises(ValueError, match=r"expected some of albedo.psnr, .* found albedo.pnsr"):
        judge(runs_of(write_run, {"ours": {"hat": [1.0]}}), [Claim("ours", "ours", ["albedo.pnsr"])], HAT)


def test_a_claim_says_what_carries_it(write_run: Write) -> None:
    values = {"ours": {"hat": [20.23, 19.51, 21.56]}, "theirs": {"hat": [20.0, 20.0, 20.0]}}
    verdict = judge(runs_of(write_run, values), [Claim("ours", "theirs", PSNR)], HAT)[0]
    assert carried_text(verdict.pairs) == "seed 2 on hat"
    assert verdict.pairs.pairs["hat"][1] == pytest.approx(-0.49)
