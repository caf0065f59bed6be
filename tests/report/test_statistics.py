"""Means and intervals against scipy's tests, and what failures, missing scenes and ties do to a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from ia_bench.report.collect import Run
from ia_bench.report.statistics import Estimate, Paired, best_rows, line, over_scenes, over_seeds, paired
from ia_bench.scores.columns import METRICS

RANDOM = np.random.default_rng(0)
PSNR, ROUGHNESS = METRICS[0], METRICS[-1]


def run(row: str, scene: str, seed: int, value: float | None, **changes: object) -> Run:
    """A finished run whose every metric is ``value``."""
    metrics = {metric.key: value for metric in METRICS}
    return Run(Path("somewhere"), row, scene, seed, **{"metrics": metrics, "seconds": value} | changes)


@pytest.mark.parametrize("count", [2, 3, 10])
def test_the_interval_over_seeds_is_students(count: int) -> None:
    values = RANDOM.normal(20, 2, count)
    low, high = scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95)
    estimate = over_seeds(values.tolist())
    assert (estimate.mean - estimate.half_width, estimate.mean + estimate.half_width) == pytest.approx((low, high))


def test_the_interval_over_two_scenes_is_welchs() -> None:
    # The mean of two scenes is half of (a - (-b)), whose interval scipy's Welch test gives.
    a, b = RANDOM.normal(20, 2, 4), RANDOM.normal(30, 0.5, 3)
    low, high = scipy.stats.ttest_ind(a, -b, equal_var=False).confidence_interval(0.95)
    estimate = over_scenes([a.tolist(), b.tolist()])
    assert (estimate.mean - estimate.half_width, estimate.mean + estimate.half_width) == pytest.approx(
        (low / 2, high / 2)
    )
    assert estimate.scenes == 2


def test_scenes_weigh_the_same_however_many_seeds_they_have() -> None:
    assert over_scenes([[10.0, 10.0, 10.0], [20.0]]) == Estimate(15.0, None, 2)


def test_one_value_has_no_interval_equal_values_have_a_zero_one_and_none_is_none() -> None:
    assert over_seeds([3.0]) == Estimate(3.0, None)
    assert over_seeds([3.0, 3.0]) == Estimate(3.0, 0.0)
    assert over_seeds([]) is None
    assert over_scenes([[], []]) is None


def test_the_paired_difference_is_scipys_and_forgets_the_scenes_own_level() -> None:
    levels, gains = RANDOM.normal(20, 8, 4), RANDOM.normal(1, 0.1, 4)
    runs = [run("none", f"s{i}", 0, level) for i, level in enumerate(levels)]
    runs += [run("ours", f"s{i}", 0, level + gain) for i, (level, gain) in enumerate(zip(levels, gains, strict=True))]
    low, high = scipy.stats.ttest_rel(levels + gains, levels).confidence_interval(0.95)
    estimate = paired(runs, "ours", "none", PSNR).over_scenes
    assert (estimate.mean - estimate.half_width, estimate.mean + estimate.half_width) == pytest.approx((low, high))
    assert estimate.scenes == 4


def test_the_paired_difference_uses_the_shared_scenes_only() -> None:
    runs = [
        run("none", "hat", 0, 10.0),
        run("none", "ship", 0, 90.0),
        run("ours", "hat", 0, 12.0),
        run("ours", "car", 0, 1.0),
    ]
    assert paired(runs, "ours", "none", PSNR).over_scenes == Estimate(2.0, None, 1)
    assert paired(runs, "ours", "nobody", PSNR).over_scenes is None


def test_a_mean_is_carried_by_the_pair_without_which_its_sign_changes() -> None:
    """One bad seed of the reference: .43 dB ahead with it, .13 dB behind without."""
    console = Paired({"console": {0: 0.23, 1: -0.49, 2: 1.56}})
    assert console.over_seeds is not None
    assert console.over_seeds.mean == pytest.approx(0.4333, abs=1e-4)
    assert console.carriers == [("console", 2)]
    assert Paired({"console": {0: 0.23, 1: 0.49, 2: 1.56}}).carriers == []
    assert Paired({"console": {0: 1.0, 1: -1.0, 2: 1.0, 3: -0.5, 4: -0.5, 5: 1.0}}).carriers == [("console", s) for s in (0, 2, 5)]


def test_carriers_are_of_the_mean_over_scenes_and_scenes_are_judged_alone() -> None:
    pairs = Paired({"hat": {0: 0.5, 1: 0.7}, "console": {0: 0.23, 1: -0.49, 2: 1.56}})
    assert pairs.carriers == []  # the other scene holds the mean up
    assert pairs.of_scene("console").carriers == [("console", 2)]
    assert Paired({"hat": {0: -0.1}, "console": {0: 1.0}}).carriers == [("console", 0)]  # a scene with its only seed
    assert Paired({"hat": {0: 1.0}}).carriers == []  # nothing is left to judge by
    assert Paired({}).carriers == []
    assert Paired({"hat": {0: 1.0, 1: -1.0}}).carriers == []  # no sign that could change


def test_failures_are_counted_and_enter_no_mean() -> None:
    runs = [
        run("ours", "hat", 0, 10.0),
        run("ours", "hat", 1, 12.0),
        run("ours", "hat", 2, None, problem="no", metrics={}),
    ]
    summary = line(runs, "ours")
    assert summary.values["albedo.psnr"].mean == 11.0
    assert (summary.failed, summary.runs) == (1, 3)
    assert summary.seconds.mean == 11.0


def test_a_row_without_runs_is_an_empty_line() -> None:
    summary = line([run("ours", "hat", 0, 10.0)], "theirs")
    assert (summary.failed, summary.runs, summary.seconds) == (0, 0, None)
    assert set(summary.values.values()) == {None}


def test_memory_is_the_largest() -> None:
    runs = [run("ours", "hat", 0, 1.0, peak_memory_bytes=5), run("ours", "ship", 0, 1.0, peak_memory_bytes=9)]
    assert line(runs, "ours").peak_memory_bytes == 9


def test_bold_goes_to_the_best_as_printed_that_is_blind_and_complete() -> None:
    runs = [run("oracle", scene, 0, 99.0, sees_truth=True) for scene in ("hat", "ship")]
    runs += [run("ours", "hat", 0, 20.001), run("ours", "ship", 0, 20.001)]
    runs += [run("theirs", "hat", 0, 20.0), run("theirs", "ship", 0, 20.0)]
    runs += [run("none", "hat", 0, 10.0), run("none", "ship", 0, 10.0)]
    runs += [run("half", "hat", 0, 50.0)]
    lines = [line(runs, row) for row in ("oracle", "ours", "theirs", "none", "half")]
    assert best_rows(lines, PSNR, scenes=2) == {"ours", "theirs"}  # both print 20.00
    assert best_rows(lines, ROUGHNESS, scenes=2) == {"none"}  # lower is better
    assert best_rows(lines[:1], PSNR, scenes=2) == set()
