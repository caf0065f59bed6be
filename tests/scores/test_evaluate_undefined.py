"""Scores of predictions that have no number in places: null, with a reason, and the rest as it was.

LPIPS needs weights, so these tests replace the network by a closed form; test_perceptual.py tests the real one.
"""

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_up import mapped
from skimage.metrics import peak_signal_noise_ratio

from ia_bench.scenes.images import Images
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.evaluate import score
from ia_bench.scores.protocol import Protocol

pytestmark = pytest.mark.usefixtures("mean_square_as_lpips")

PAPER = Protocol()


def test_the_truth_itself_is_infinitely_good_and_null_in_json_with_its_reason(truth: Predictions) -> None:
    scores = score(truth, truth, PAPER)
    assert scores.metrics["albedo"] == {"psnr": math.inf, "ssim": pytest.approx(1.0), "lpips": 0.0}
    assert scores.metrics["roughness"] == {"mse": 0.0}
    stored = scores.as_dict()
    assert stored["metrics"]["albedo"]["psnr"] is None
    assert stored["per_image"]["albedo"]["psnr"] == [None] * 3
    assert stored["reasons"]["albedo.psnr"] == "identical (every image)"
    assert stored["reasons"]["per_image.relighting.night.psnr"] == "identical (every image)"
    assert "albedo.ssim" not in stored["reasons"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_broken_pixel_costs_its_component_and_no_other(guess: Predictions, truth: Predictions, bad: float) -> None:
    images = [image.copy() for image in guess.albedo.images]
    images[1][18, 21, 2] = bad
    scores = score(replace(guess, albedo=Images(tuple(images), guess.albedo.coverage)), truth, PAPER)
    assert scores.metrics["albedo"] == {"psnr": None, "ssim": None, "lpips": None}
    assert scores.metrics["aligned_albedo"]["psnr"] is None
    assert scores.albedo_scales["mean_rgb"] is None
    assert scores.reasons["albedo.ssim"] == "the prediction is not finite in 1 scored pixels (image 1)"
    assert "cannot be aligned" in scores.reasons["aligned_albedo.psnr"]
    stored = scores.as_dict()
    assert [value is None for value in stored["per_image"]["albedo"]["psnr"]] == [False, True, False]
    assert scores.metrics["view_synthesis"] == score(guess, truth, PAPER).metrics["view_synthesis"]
    json.dumps(stored, allow_nan=False)


def test_what_has_no_truth_is_null_for_another_reason_whatever_is_predicted(guess: Predictions, truth: Predictions) -> None:
    without = replace(truth, albedo=None, relighting=None)
    for predictions in (guess, replace(guess, albedo=None, relighting=None)):
        scores = score(predictions, without, PAPER)
        assert scores.metrics["albedo"] == {"psnr": None, "ssim": None, "lpips": None}
        assert scores.reasons["albedo.psnr"] == "the scene has no true albedo in its test views"
        assert scores.reasons["aligned_albedo.psnr"] == scores.reasons["albedo.psnr"]
        assert scores.reasons["relighting.psnr"] == "the scene has no view under a novel light whose map it knows"
        assert scores.metrics["roughness"] == score(guess, truth, PAPER).metrics["roughness"]


def test_the_whole_image_is_psnr_over_white_by_each_ones_own_coverage(guess: Predictions, truth: Predictions) -> None:
    def over_white(images: Images, view: int) -> np.ndarray:
        share = images.coverage[view][..., None]
        linear = np.clip(images.images[view] / np.where(share > 0, share, 1), 0, 1)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return share * encoded + 1 - share

    smaller = replace(guess, albedo=Images(guess.albedo.images, tuple(np.minimum(1.25 * c, 1) for c in guess.albedo.coverage)))
    expected = [
        peak_signal_noise_ratio(over_white(truth.albedo, view), over_white(smaller.albedo, view), data_range=1) for view in range(3)
    ]
    scores = score(smaller, truth, PAPER)
    assert scores.per_image["albedo_whole_image"]["psnr"] == pytest.approx(expected, abs=1e-9)
    assert scores.variants["albedo_whole_image"]["psnr"] > scores.metrics["albedo"]["psnr"] + 3  # most pixels are background


def test_one_factor_for_each_photograph_takes_its_exposure_away(guess: Predictions, truth: Predictions) -> None:
    factors = (0.4, 0.9, 1.7)  # of a camera that exposes by itself; covered pixels alone tell them
    seen = truth.view_synthesis
    dark = Images(tuple(factor * image for factor, image in zip(factors, seen.images, strict=True)), seen.coverage)
    scores = score(replace(guess, view_synthesis=dark), truth, PAPER)
    assert scores.metrics["view_synthesis"]["psnr"] < 30
    assert min(scores.per_image["view_synthesis_exposed"]["psnr"]) > 60

    def pierced_by(images: Images) -> Images:
        kept = [np.arange(share.shape[1]) % 2 == 1 for share in images.coverage]
        pairs = zip(images.images, images.coverage, kept, strict=True)
        images, shares = zip(*((image * k[:, None], share * k) for image, share, k in pairs), strict=True)
        return Images(images, shares)

    pierced, whole = (score(replace(guess, view_synthesis=pierced_by(images)), truth, PAPER) for images in (dark, seen))
    expected = whole.per_image["view_synthesis"]["psnr"]
    assert pierced.per_image["view_synthesis_exposed"]["psnr"] == pytest.approx(expected, abs=1e-6)


def test_a_view_without_scored_pixels_is_left_out_and_counted(guess: Predictions, truth: Predictions) -> None:
    def with_empty(images: Images) -> Images:
        return Images((*images.images, images.images[0]), (*images.coverage, images.coverage[0] * 0.0 + 0.5))

    more = replace(guess, albedo=with_empty(guess.albedo)), replace(truth, albedo=with_empty(truth.albedo))
    scores = score(*more, PAPER)
    assert scores.metrics["albedo"] == score(guess, truth, PAPER).metrics["albedo"]
    assert scores.counts["albedo"]["views_without_scored_pixel"] == 1
    assert scores.reasons["per_image.albedo.psnr"] == "no scored pixel (image 3)"
    assert "albedo.psnr" not in scores.reasons
    assert scores.variants["albedo_whole_image"] == score(guess, truth, PAPER).variants["albedo_whole_image"]
    assert scores.counts["albedo_whole_image"]["views_without_scored_pixel"] == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: replace(t, albedo=Images(t.albedo.images[:2], t.albedo.coverage[:2])), "albedo: expected 2 views, found 3"),
        (lambda t: replace(t, view_synthesis=t.roughness), r"view_synthesis, view 0: expected shape \(37, 43\)"),
        (lambda t: replace(t, relighting={"night": t.relighting["night"]}), r"expected the lights \['night'\], found"),
        (lambda t: replace(t, roughness=t.albedo), r"roughness, view 0: expected shape \(37, 43, 3\)"),
        (lambda t: replace(t, albedo=mapped(t.albedo, lambda c: c * np.nan)), "view 0: the ground truth is not finite"),
    ],
)
def test_a_truth_that_does_not_fit_is_an_error(
    guess: Predictions, truth: Predictions, change: Callable[[Predictions], Predictions], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        score(guess, change(truth), PAPER)


def test_saturated_pixels_of_photographs_are_left_out(guess: Predictions, truth: Predictions) -> None:
    images, coverage = truth.view_synthesis.images, truth.view_synthesis.coverage
    saturated = np.zeros(coverage[0].shape, bool)
    saturated[15:20, 15:30] = True
    wild = tuple(np.where(saturated[..., None], 7.0, image) for image in images)
    known = Images(images, coverage, (~saturated,) * 3)
    unseen = replace(truth, view_synthesis=known)
    spoiled = replace(truth, view_synthesis=Images(wild, coverage, (~saturated,) * 3))
    plain, left_out, blown = (score(guess, of, PAPER) for of in (truth, unseen, spoiled))
    assert left_out.metrics == blown.metrics
    assert left_out.variants == blown.variants
    assert left_out.metrics["view_synthesis"] != plain.metrics["view_synthesis"]
    counts = [scores.counts["view_synthesis"]["scored_pixels"] for scores in (plain, left_out)]
    assert counts[0] - counts[1] == sum(int((c[saturated] > 0.5).sum()) for c in coverage) > 0
