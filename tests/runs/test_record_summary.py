"""What a run says of its scores on the command line: numbers, and in one line what nobody could measure."""

import numpy as np
import pytest

from ia_bench.runs.record import LACKING, RunRecord
from ia_bench.scenes.images import Images
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.evaluate import NO_TRUTH, score
from ia_bench.scores.protocol import Protocol

HEAD = "none, scene owl, seed 0, protocol p:"


def pictures(level: float) -> Images:
    """One view, all of it the object's and as bright."""
    return Images((np.full((40, 40, 3), level),), (np.ones((40, 40)),))


def summary(predictions: Predictions, truth: Predictions) -> list[str]:
    found = score(predictions, truth, Protocol())
    scores = {"metrics": found.as_dict()["metrics"], "reasons": found.reasons}
    return RunRecord(row="none", scene="owl", seed=0, protocol="p", config_hash="", status="ok", **scores).summary().split("\n")


def test_of_photographs_one_line_names_all_without_a_truth_and_another_reason_is_said_as_it_is() -> None:
    """sRGB of .2 and .25 are .48453 and .53710, whose difference is 25.59 dB below 1."""
    head, shown, rest = summary(Predictions(view_synthesis=pictures(0.2)), Predictions(view_synthesis=pictures(0.25)))
    assert head == HEAD
    assert shown.startswith("  view_synthesis  psnr 25.59, ")
    assert "undefined" not in shown
    title, _, names = rest.partition(": ")
    assert title == "  not scored (no truth)"
    lacking = {"albedo", "aligned_albedo", "relighting", "roughness", "light", "log_light", "albedo_error"}
    assert sorted(names.split(", ")) == sorted(lacking)
    grey = pictures(0.2)
    lines = summary(Predictions(albedo=grey), Predictions(albedo=grey, view_synthesis=grey, roughness=None))
    assert "  not scored (the method does not predict view synthesis): view_synthesis" in lines
    assert "  not scored (no truth): relighting, roughness, light, log_light, albedo_error" in lines
    assert any(line.startswith("  albedo          psnr undefined, ssim 1") for line in lines), "identical"
    assert not any(line.startswith("  view_synthesis") for line in lines)


@pytest.mark.parametrize("reason", [*NO_TRUTH.values(), "the scene has no true mesh"])
def test_every_reason_of_the_scorer_for_truth_that_is_missing_is_known_as_one(reason: str) -> None:
    assert reason.startswith(LACKING)
