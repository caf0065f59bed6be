"""Means and intervals against scipy's tests, and what failures, missing scenes and ties do to a table."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from scored_runs import scored

from ia_bench.report.blocks import Block, block
from ia_bench.report.collect import Record, as_table
from ia_bench.report.statistics import Estimate, Paired, Verdict, holm, judge, over_scenes, paired, side_by_side
from ia_bench.report.write import write_report
from ia_bench.runs.table import Claim, Row, Table
from ia_bench.scores.metrics import METRICS

RANDOM = np.random.default_rng(0)
PSNR, ROUGHNESS = METRICS[0], METRICS[-1]


def between(estimate: Estimate | None) -> tuple[float, float]:
    return estimate.mean - estimate.half_width, estimate.mean + estimate.half_width


def block_of(records: list[Record], rows: list[str], scenes: list[str]) -> Block:
    return block(as_table(records), rows, scenes, "all")


def difference(records: list[Record], row: str, reference: str) -> Paired:
    return paired(side_by_side(as_table(records), PSNR.column), row, reference)


@pytest.mark.parametrize("count", [2, 3, 10])
def test_the_interval_over_seeds_is_students(count: int) -> None:
    values = RANDOM.normal(20, 2, count)
    assert between(over_scenes([values.tolist()])) == pytest.approx(scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95))


def test_the_interval_over_two_scenes_is_welchs_and_what_was_not_repeated_has_none() -> None:
    """The mean of two scenes is half of (a - (-b)), whose interval scipy's Welch test gives."""
    a, b = RANDOM.normal(20, 2, 4), RANDOM.normal(30, 0.5, 3)
    low, high = scipy.stats.ttest_ind(a, -b, equal_var=False).confidence_interval(0.95)
    estimate = over_scenes([a.tolist(), b.tolist()])
    assert between(estimate) == pytest.approx((low / 2, high / 2))
    assert estimate.scenes == 2
    assert over_scenes([[10.0, 10.0, 10.0], [20.0]]) == Estimate(15.0, None, 2, pytest.approx(12.7062047 * 5))
    assert over_scenes([[3.0]]) == Estimate(3.0, None)
    assert over_scenes([[3.0, 3.0]]) == Estimate(3.0, 0.0)
    assert over_scenes([[]]) is None
    assert over_scenes([[], []]) is None


def test_the_paired_difference_is_scipys_of_shared_scenes_and_forgets_their_own_levels() -> None:
    levels, gains = RANDOM.normal(20, 8, 4), RANDOM.normal(1, 0.1, 4)
    runs = [scored("none", f"s{i}", 0, level) for i, level in enumerate(levels)]
    runs += [scored("ours", f"s{i}", 0, level + gain) for i, (level, gain) in enumerate(zip(levels, gains, strict=True))]
    expected = scipy.stats.ttest_rel(levels + gains, levels).confidence_interval(0.95)
    found = difference(runs, "ours", "none").over_seeds
    assert (found.mean - found.wider, found.mean + found.wider) == pytest.approx(expected)
    runs = [scored("none", "hat", 0, 10.0), scored("none", "ship", 0, 90.0)]
    runs += [scored("ours", "hat", 0, 12.0), scored("ours", "car", 0, 1.0)]
    assert difference(runs, "ours", "none").over_seeds == Estimate(2.0, None, 1)
    assert difference(runs, "ours", "nobody").over_seeds is None


def test_a_mean_is_carried_by_the_pair_without_which_its_sign_changes() -> None:
    """One bad seed of the reference: .43 dB ahead with it, .13 dB behind without."""
    console = Paired({"console": {0: 0.23, 1: -0.49, 2: 1.56}})
    assert console.over_seeds.mean == pytest.approx(0.4333, abs=1e-4)
    assert console.carriers == [("console", 2)]
    assert Paired({"console": {0: 0.23, 1: 0.49, 2: 1.56}}).carriers == []
    assert Paired({"console": {0: 1.0, 1: -1.0, 2: 1.0, 3: -0.5, 4: -0.5, 5: 1.0}}).carriers == [("console", s) for s in (0, 2, 5)]
    pairs = Paired({"hat": {0: 0.5, 1: 0.7}, "console": {0: 0.23, 1: -0.49, 2: 1.56}})
    assert pairs.carriers == []  # the other scene holds the mean up
    assert pairs.of_scene("console").carriers == [("console", 2)]
    assert Paired({"hat": {0: -0.1}, "console": {0: 1.0}}).carriers == [("console", 0)]  # a scene with its only seed
    assert Paired({"hat": {0: 1.0}}).carriers == []  # nothing is left to judge by
    assert Paired({}).carriers == []
    assert Paired({"hat": {0: 1.0, 1: -1.0}}).carriers == []  # no sign that could change


def test_failures_are_counted_and_enter_no_mean() -> None:
    runs = [scored("ours", "hat", seed, 10.0 + 2 * seed, seconds=3.0, peak_memory_bytes=5 + seed) for seed in (0, 1)]
    runs.append(scored("ours", "hat", 2, None, problem="no"))
    ours, theirs = block_of(runs, ["ours", "theirs"], ["hat"]).lines
    assert ours.values["albedo.psnr"].mean == 11.0
    assert (ours.failed, ours.runs, ours.seconds, ours.peak_memory_bytes) == (1, 3, Estimate(3.0, 0.0), 6)
    assert (theirs.failed, theirs.runs, theirs.seconds, theirs.peak_memory_bytes) == (0, 0, None, None)
    assert set(theirs.values.values()) == {None}


def test_bold_goes_to_the_best_that_is_blind_and_complete_where_its_lead_is_decided() -> None:
    """A lead of 1 dB in every scene, and one in roughness that the other scenes take back."""
    scenes = ("hat", "ship", "console")
    runs = [scored("oracle", scene, 0, 99.0, sees_truth=True) for scene in scenes]
    for place, scene in enumerate(scenes):
        runs.append(scored("none", scene, 0, 20.0 + 5 * place, roughness_mse=0.02))
        runs.append(scored("ours", scene, 0, 21.0 + 5.01 * place, roughness_mse=(0.01, 0.01, 0.039)[place]))
    runs += [scored("half", "hat", seed, 50.0) for seed in (0, 1)]
    found = block_of(runs, ["oracle", "ours", "none", "half"], [*scenes])
    assert [one.row for one in found.lines if found.is_best(one.row, PSNR)] == ["ours"]
    assert (found.leaders["albedo.psnr"].second, found.leaders["albedo.psnr"].sure) == ("none", "decided")
    least = found.leaders["roughness.mse"]
    assert (least.row, least.sure) == ("ours", "undecided: other scenes may turn it")
    assert not any(found.is_best(one.row, ROUGHNESS) for one in found.lines)
    assert block_of(runs[:3], ["oracle"], [*scenes]).leaders == {}
    assert block_of(runs[3:4], ["none"], ["hat"]).leaders["albedo.psnr"].sure == "the only row"


@pytest.mark.parametrize(
    ("seeds", "words"),
    [
        ({"hat": (0, 1), "ship": (0, 1)}, "decided"),
        ({"hat": (0, 1), "ship": (2, 3)}, "too few runs in common: how sure is unknown"),
        ({"hat": (2, 3), "ship": (2, 3)}, "too few runs in common: how sure is unknown"),
        ({"hat": (0, 1), "ship": (1, 2)}, "decided"),
    ],
)
def test_a_lead_is_decided_by_pairs_in_every_scene(seeds: dict[str, tuple[int, int]], words: str) -> None:
    runs = [scored("none", scene, seed, 15.0 + seed) for scene in seeds for seed in (0, 1)]
    runs += [scored("ours", scene, seed, 25.0 + seed) for scene, mine in seeds.items() for seed in mine]
    leader = block_of(runs, ["none", "ours"], ["hat", "ship"]).leaders["albedo.psnr"]
    assert (leader.row, leader.second, leader.sure) == ("ours", "none", words)


# ---- claimed orderings, against differences and intervals worked out by hand ----
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
        ([22.0, 22.1, 21.9], [20.0, 20.1, 20.0], "reproduced"),
        ([20.0, 20.1, 20.0], [22.0, 22.1, 21.9], "not reproduced"),
        ([22.0, 18.0, 20.5], [20.0, 20.1, 20.0], "undecided"),
        ([22.0], [20.0], "undecided"),  # no repetition, no interval
    ],
)
def test_outcome_is_where_the_interval_lies(ours: list[float], theirs: list[float], expected: str) -> None:
    assert verdict({"ours": {"hat": ours}, "theirs": {"hat": theirs}}).outcome == expected


def test_a_missing_scene_leaves_it_undecided_and_a_lower_error_is_an_advantage() -> None:
    """What survives of a row that failed elsewhere says nothing about the table."""
    values = {"ours": {"hat": [30.0, 30.1]}, "theirs": {"hat": [20.0, 20.1], "ship": [20.0, 20.1]}}
    assert verdict(values).outcome == "reproduced"
    assert verdict(values, ["hat", "ship"]).outcome == "undecided"
    found = verdict({"ours": {"hat": [0.010, 0.011, 0.012]}, "theirs": {"hat": [0.030, 0.031, 0.032]}}, metric="roughness.mse")
    assert found.pairs.over_seeds.mean == pytest.approx(0.02)
    assert found.outcome == "reproduced"


# ---- many comparisons at once, and scenes that nobody has seen ----
def test_holm_is_worked_out_by_hand() -> None:
    """Five tests: .05 / 5 = .01, .0125, .01667, .025, .05. The fourth fails, and so the fifth, which alone would pass."""
    assert holm([0.045, 0.001, 0.026, 0.016, 0.012, None]) == [False, True, False, True, True, False]
    assert holm([0.02, 0.02, 0.02]) == [False] * 3, "each is decided alone, but .02 > .05 / 3"
    assert holm([0.05]) == [True]
    assert holm([]) == []


def test_what_is_decided_only_alone_is_called_so() -> None:
    """One claim of p = .018 stands by itself, and falls among four."""
    values = {"ours": {"a": [1.0], "b": [2.0], "c": [1.4]}, "theirs": dict.fromkeys("abc", [0.0])}
    scenes = ["a", "b", "c"]
    assert verdict(values, scenes).outcome == "reproduced"
    assert verdict(values, scenes).p_value == pytest.approx(scipy.stats.ttest_1samp([1.0, 2.0, 1.4], 0).pvalue)
    runs = as_table([scored(row, scene, 0, *value) for row, found in values.items() for scene, value in found.items()])
    keys = ["albedo.psnr", "albedo.ssim", "relighting.psnr", "relighting.ssim"]
    several = judge(runs, [Claim("ours", "theirs", keys), Claim("theirs", "ours", keys[:1])], scenes)
    assert [one.outcome for one in several] == ["reproduced alone"] * 4 + ["not reproduced alone"]


def test_a_sign_test_wants_eight_scenes() -> None:
    values = {f"s{place}": {0: 1.0} for place in range(7)}
    assert Paired(values).signs is None
    assert Paired({**values, "last": {0: -1.0}}).signs == (7, 8, pytest.approx(2 * 9 / 2**8))
    assert Paired({**values, "last": {0: 0.0}}).signs == (7, 7, pytest.approx(2 / 2**7)), "a tie says nothing"


def drawn(generator: np.random.Generator, scenes: int, spread: float = 1.0, mean: float = 0.0) -> Paired:
    """Differences whose truth is ``mean``: scenes differ by ``spread``, two seeds of each by 1."""
    levels = generator.normal(mean, spread, scenes)
    return Paired({f"s{place}": dict(enumerate(generator.normal(level, 1.0, 2))) for place, level in enumerate(levels)})


@pytest.mark.parametrize("scenes", [1, 4, 8])
def test_a_family_without_any_difference_is_decided_in_at_most_five_of_a_hundred_experiments(scenes: int) -> None:
    """1000 experiments of 12 comparisons. A rate of .05 exceeds .07 with a probability of .002, the false alarm of this test.

    Of one scene, seeds are the sample, and its level is no deviation. Alone, almost half of all experiments would decide something.
    """
    generator = np.random.default_rng(scenes)
    families = [[drawn(generator, scenes, spread=float(scenes > 1)).p_value for _ in range(12)] for _ in range(1000)]
    assert scipy.stats.binom.sf(int(0.07 * 1000), 1000, 0.05) < 0.003
    assert np.mean([any(holm(family)) for family in families]) <= 0.07
    assert np.mean([min(p for p in family if p is not None) <= 0.05 for family in families]) > 0.4


@pytest.mark.parametrize("scenes", [2, 4, 8])
def test_the_prediction_interval_holds_a_new_scene_in_95_of_a_hundred(scenes: int) -> None:
    """2000 experiments: a coverage of .95 leaves .934 to .966 with a probability of .001, the false alarm of this test."""
    generator = np.random.default_rng(scenes)
    held = []
    for _ in range(2000):
        pairs, new = drawn(generator, scenes, mean=3.0), drawn(generator, 1, mean=3.0)
        held.append(abs(new.scenes[0] - pairs.scenes.mean()) <= pairs.new_scene)
    inside = scipy.stats.binom.cdf([int(0.934 * 2000), int(0.966 * 2000)], 2000, 0.95)
    assert 1 - np.diff(inside)[0] < 0.002
    assert 0.934 <= np.mean(held) <= 0.966


def test_the_prediction_interval_is_students() -> None:
    values = [1.0, 2.0, 4.0]
    width = scipy.stats.t.ppf(0.975, 2) * np.std(values, ddof=1) * (1 + 1 / 3) ** 0.5
    assert Paired({str(value): {0: value} for value in values}).new_scene == pytest.approx(width)
    assert Paired({"hat": {0: 1.0, 1: 2.0}}).new_scene is None, "one scene says nothing of others"


def test_a_mean_over_fewer_scenes_has_no_p_value(tmp_path: Path, write_run: Callable[..., Path]) -> None:
    """The p-value of one scene is over its seeds, and says nothing of scenes."""
    folders = [write_run("none", scene, seed, psnr=20.0 + seed) for scene in ("hat", "ship") for seed in range(3)]
    folders += [write_run("ours", "hat", seed, psnr=21.0 + 1.1 * seed) for seed in range(3)]
    write_report(
        folders, tmp_path, Table(rows=[Row("ours", [])], reference="none", claims=[Claim("ours", "none", ["albedo.psnr"])])
    )
    for name in ("claims.csv", "differences.csv"):
        lines = [one for one in csv.DictReader((tmp_path / name).open()) if one["metric"] == "albedo.psnr"]
        told = {one["scene"]: (one["p_value"] != "", one["scenes"]) for one in lines if one.get("row", "ours") == "ours"}
        assert told == {"mean over scenes": (False, "1"), "hat": (True, "1")}, name
