"""Scores of whole predictions: independent recomputation, metamorphic relations, and inputs that have no number.

LPIPS needs weights, so these tests replace the network by a closed form; test_perceptual.py tests the real one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from ia_bench.scenes.images import Images
from ia_bench.scores import components
from ia_bench.scores.evaluate import albedo_scale, score, score_quick
from ia_bench.scores.metrics import squared_error
from ia_bench.scores.predictions import Predictions
from ia_bench.scores.protocol import Protocol

PAPER = Protocol()


@pytest.fixture(autouse=True)
def root_mean_square_as_lpips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Root mean square in place of the network: quick, zero for identical images, blind outside the mask."""

    def distance(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray, settings: object) -> float:
        return math.sqrt(squared_error(predicted, true, mask))

    monkeypatch.setattr(components, "lpips", distance)


def mapped(images: Images, change: Callable[[np.ndarray], np.ndarray]) -> Images:
    """Apply a change to the un-premultiplied colours."""
    weights = [c if i.ndim == 2 else c[..., None] for i, c in zip(images.images, images.coverage, strict=True)]
    colours = (i / np.where(w > 0, w, 1) for i, w in zip(images.images, weights, strict=True))
    return Images(tuple(change(c) * w for c, w in zip(colours, weights, strict=True)), images.coverage)


def by_hand(predicted: Images, true: Images, scale: float = 1.0) -> float:
    """Mean PSNR in sRGB over the views, from scikit-image on flat lists of masked pixels."""

    def encoded(image: np.ndarray, coverage: np.ndarray, factor: float) -> np.ndarray:
        linear = np.clip(factor * image[coverage > 0.5] / coverage[coverage > 0.5][:, None], 0, 1)
        return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)

    values = [
        peak_signal_noise_ratio(encoded(t, ct, 1.0), encoded(p, cp, scale), data_range=1)
        for p, cp, t, ct in zip(predicted.images, predicted.coverage, true.images, true.coverage, strict=True)
    ]
    return float(np.mean(values))


def test_every_component_against_scikit_image(guess: Predictions, truth: Predictions) -> None:
    scores = score(guess, truth, PAPER)
    inside = [coverage > 0.5 for coverage in truth.albedo.coverage]

    def mean_rgb(images: Images) -> float:
        views = zip(images.images, images.coverage, inside, strict=True)
        return float(np.concatenate([image[m] / c[m][:, None] for image, c, m in views]).mean())

    scale = mean_rgb(truth.albedo) / mean_rgb(guess.albedo)
    relit = [by_hand(guess.relighting[light], truth.relighting[light]) for light in ("night", "studio")]
    expected = {
        "albedo": by_hand(guess.albedo, truth.albedo),
        "aligned_albedo": by_hand(guess.albedo, truth.albedo, scale),
        "view_synthesis": by_hand(guess.view_synthesis, truth.view_synthesis),
        "relighting": float(np.mean(relit)),
    }
    assert {name: scores.metrics[name]["psnr"] for name in expected} == pytest.approx(expected, abs=1e-9)
    assert scores.albedo_scales["mean_rgb"] == pytest.approx([scale] * 3, rel=1e-12)
    assert albedo_scale(guess.albedo, truth.albedo, PAPER).scale == pytest.approx([scale] * 3, rel=1e-12)

    rough = zip(guess.roughness.images, truth.roughness.images, truth.roughness.coverage, inside, strict=True)
    errors = [np.square((p[m] - t[m]) / c[m]).mean() for p, t, c, m in rough]
    assert scores.metrics["roughness"] == {"mse": pytest.approx(np.mean(errors), rel=1e-9)}


def test_the_dictionary_has_the_documented_keys_and_is_json(guess: Predictions, truth: Predictions) -> None:
    stored = json.loads(json.dumps(score(guess, truth, PAPER).as_dict(), allow_nan=False))
    triple = {"psnr", "ssim", "lpips"}
    assert {name: set(values) for name, values in stored["metrics"].items()} == {
        **{name: triple for name in ("albedo", "aligned_albedo", "view_synthesis", "relighting")},
        "roughness": {"mse"},
    }
    assert {name: set(values) for name, values in stored["variants"].items()} == {
        "albedo_linear": {"psnr"},
        "aligned_albedo_linear": {"psnr"},
        "aligned_albedo_per_channel": triple,
        "aligned_albedo_per_channel_linear": {"psnr"},
        "aligned_albedo_least_squares": triple,
        "aligned_albedo_least_squares_linear": {"psnr"},
        "albedo_whole_image": {"psnr"},
        "aligned_albedo_whole_image": {"psnr"},
        "view_synthesis_whole_image": {"psnr"},
        "relighting_whole_image": {"psnr"},
    }
    assert stored["protocol"] == "paper-v2 (lpips.net=squeeze)"
    assert stored["protocol_description"]["alignment"] == "mean_rgb"
    assert stored["reasons"] == {}
    assert [len(stored["per_image"]["relighting"][light]["ssim"]) for light in ("night", "studio")] == [3, 3]
    assert np.mean(stored["per_image"]["albedo"]["ssim"]) == pytest.approx(stored["metrics"]["albedo"]["ssim"])


# ---- metamorphic relations ----


@pytest.mark.parametrize("factor", [0.25, 2.0])
def test_the_scale_of_the_prediction_is_aligned_away(guess: Predictions, truth: Predictions, factor: float) -> None:
    before = score(guess, truth, PAPER)
    after = score(replace(guess, albedo=mapped(guess.albedo, lambda c: factor * c)), truth, PAPER)
    for name in ("aligned_albedo", "aligned_albedo_per_channel", "aligned_albedo_least_squares"):
        old, new = ({**s.metrics, **s.variants}[name] for s in (before, after))
        assert new == pytest.approx(old, abs=1e-9)
    assert after.metrics["albedo"]["psnr"] != pytest.approx(before.metrics["albedo"]["psnr"], abs=0.1)
    assert after.metrics["view_synthesis"] == before.metrics["view_synthesis"]


def test_gamma_is_not_aligned_away(truth: Predictions) -> None:
    bent = replace(truth, albedo=mapped(truth.albedo, lambda c: c**2.2))
    scores = score(bent, truth, PAPER)
    for name in ("aligned_albedo", "aligned_albedo_per_channel", "aligned_albedo_least_squares"):
        assert {**scores.metrics, **scores.variants}[name]["psnr"] < 25


def test_a_colour_cast_shows_in_the_papers_alignment_and_hides_in_the_per_channel_one(truth: Predictions) -> None:
    cast = np.array([1.1, 1.0, 0.7])
    scores = score(replace(truth, albedo=mapped(truth.albedo, lambda c: c * cast)), truth, PAPER)
    assert scores.variants["aligned_albedo_per_channel"]["psnr"] > 200
    assert scores.metrics["aligned_albedo"]["psnr"] < 30


def test_what_is_outside_the_mask_changes_nothing(guess: Predictions, truth: Predictions) -> None:
    def littered(images: Images) -> Images:
        outside = [c <= 0.5 for c in images.coverage]
        pairs = zip(images.images, outside, strict=True)
        return Images(tuple(np.where(o if i.ndim == 2 else o[..., None], np.nan, i) for i, o in pairs), images.coverage)

    lit = {light: littered(images) for light, images in guess.relighting.items()}
    parts = (littered(images) for images in (guess.albedo, guess.roughness, guess.view_synthesis))
    clean, dirty = (score(one, truth, PAPER) for one in (guess, Predictions(*parts, lit)))
    whole = [name for name in clean.variants if name.endswith("_whole_image")]
    assert len(whole) == 4
    for name in whole:  # which look at every pixel
        assert dirty.variants.pop(name) == {"psnr": None} != clean.variants.pop(name)
        for scores in (clean, dirty):
            del scores.per_image[name], scores.counts[name]
    assert all("_whole_image" in key for key in dirty.reasons)
    dirty.reasons.clear()
    assert dirty == clean


def test_the_order_of_views_changes_only_the_order_of_values(guess: Predictions, truth: Predictions) -> None:
    def turned(images: Images) -> Images:
        return Images(images.images[::-1], images.coverage[::-1])

    def turn(all_of: Predictions) -> Predictions:
        lit = {light: turned(images) for light, images in reversed(all_of.relighting.items())}
        return Predictions(turned(all_of.albedo), turned(all_of.roughness), turned(all_of.view_synthesis), lit)

    before, after = score(guess, truth, PAPER), score(turn(guess), turn(truth), PAPER)
    for name, values in before.metrics.items():
        assert after.metrics[name] == pytest.approx(values, rel=1e-12)
    assert after.per_image["albedo"]["ssim"] == pytest.approx(before.per_image["albedo"]["ssim"][::-1], rel=1e-12)


def test_the_coverage_of_the_prediction_is_divided_out(guess: Predictions, truth: Predictions) -> None:
    thin = Images(tuple(i / 2 for i in guess.albedo.images), tuple(c / 2 for c in guess.albedo.coverage))
    assert score(replace(guess, albedo=thin), truth, PAPER).metrics["albedo"] == pytest.approx(
        score(guess, truth, PAPER).metrics["albedo"], rel=1e-9
    )


def test_samples_and_name_do_not_touch_the_numbers_and_the_mask_threshold_does(
    guess: Predictions, truth: Predictions
) -> None:
    plain = score(guess, truth, PAPER).metrics
    assert score(guess, truth, replace(PAPER, name="mine", samples_per_pixel=7)).metrics == plain
    assert score(guess, truth, replace(PAPER, mask_threshold=0.9)).metrics["albedo"] != plain["albedo"]


def test_the_encoding_of_the_variant_is_the_other_one(guess: Predictions, truth: Predictions) -> None:
    srgb, linear = score(guess, truth, PAPER), score(guess, truth, replace(PAPER, albedo_encoding="linear"))
    assert srgb.variants["aligned_albedo_linear"]["psnr"] == linear.metrics["aligned_albedo"]["psnr"]
    assert linear.variants["aligned_albedo_srgb"]["psnr"] == srgb.metrics["aligned_albedo"]["psnr"]


# ---- inputs without a number ----


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


def test_a_black_albedo_has_a_score_and_no_alignment(guess: Predictions, truth: Predictions) -> None:
    scores = score(replace(guess, albedo=mapped(guess.albedo, np.zeros_like)), truth, PAPER)
    assert scores.metrics["albedo"]["psnr"] > 0
    assert scores.metrics["aligned_albedo"] == {"psnr": None, "ssim": None, "lpips": None}
    assert "no positive scale" in scores.reasons["aligned_albedo.lpips"]


def test_uncovered_pixels_count_as_black_and_are_counted(guess: Predictions, truth: Predictions) -> None:
    holes = [c.copy() for c in guess.view_synthesis.coverage]
    holes[0][15:20, 18:22] = 0
    filled = [i.copy() for i in guess.view_synthesis.images]
    filled[0][15:20, 18:22] = 0
    with_holes = Images(guess.view_synthesis.images, tuple(holes))
    black = Images(tuple(filled), guess.view_synthesis.coverage)
    scores = [score(replace(guess, view_synthesis=images), truth, PAPER) for images in (with_holes, black)]
    assert scores[0].metrics["view_synthesis"] == scores[1].metrics["view_synthesis"]
    assert [s.counts["view_synthesis"]["uncovered_pixels"] for s in scores] == [20, 0]


def test_clipped_values_are_counted(guess: Predictions, truth: Predictions) -> None:
    glaring = score(replace(guess, view_synthesis=mapped(guess.view_synthesis, lambda c: c + 1.0)), truth, PAPER)
    counts = glaring.counts["view_synthesis"]
    assert counts["clipped_prediction"] == 3 * counts["scored_pixels"]
    assert counts["clipped_truth"] == 0


def test_what_is_not_predicted_is_null_and_the_rest_is_scored(guess: Predictions, truth: Predictions) -> None:
    scores = score(replace(guess, roughness=None, relighting=None), truth, PAPER)
    assert scores.metrics["roughness"] == {"mse": None}
    assert scores.reasons["roughness.mse"] == "the method does not predict roughness"
    assert scores.reasons["relighting.lpips"] == "the method does not predict relighting"
    assert scores.metrics["albedo"] == score(guess, truth, PAPER).metrics["albedo"]


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


def test_a_view_without_scored_pixels_is_left_out_and_counted(guess: Predictions, truth: Predictions) -> None:
    def with_empty(images: Images) -> Images:
        return Images((*images.images, images.images[0]), (*images.coverage, images.coverage[0] * 0.0 + 0.5))

    more = replace(guess, albedo=with_empty(guess.albedo)), replace(truth, albedo=with_empty(truth.albedo))
    scores = score(*more, PAPER)
    assert scores.metrics["albedo"] == score(guess, truth, PAPER).metrics["albedo"]
    assert scores.counts["albedo"]["views_without_scored_pixel"] == 1
    assert scores.reasons["per_image.albedo.psnr"] == "no scored pixel (image 3)"
    assert "albedo.psnr" not in scores.reasons


def test_no_scored_pixel_anywhere(guess: Predictions, truth: Predictions) -> None:
    nothing = Images(truth.roughness.images, tuple(0.4 * c for c in truth.roughness.coverage))
    scores = score(guess, replace(truth, roughness=nothing), PAPER)
    assert scores.metrics["roughness"] == {"mse": None}
    assert scores.reasons["roughness.mse"] == "no scored pixel (every image)"


def test_no_view_at_all(guess: Predictions, truth: Predictions) -> None:
    scores = score(replace(guess, albedo=Images((), ())), replace(truth, albedo=Images((), ())), PAPER)
    assert scores.metrics["albedo"]["psnr"] is None
    assert scores.reasons["albedo.psnr"] == "no image"
    assert "no scored pixel" in scores.reasons["aligned_albedo.psnr"]


def test_tiny_images_have_psnr_and_a_reason_for_the_rest() -> None:
    small = [Images((np.full((4, 5, 3), value),), (np.ones((4, 5)),)) for value in (0.5, 0.25)]
    scores = score(Predictions(albedo=small[0]), Predictions(albedo=small[1]), PAPER)
    assert scores.metrics["aligned_albedo"]["psnr"] == math.inf
    assert scores.metrics["albedo"]["ssim"] is None
    assert "5 x 4 pixels is smaller than the window of 11" in scores.reasons["albedo.ssim"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: replace(t, albedo=Images(t.albedo.images[:2], t.albedo.coverage[:2])),
            "albedo: expected 2 views, found 3",
        ),
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


@pytest.mark.parametrize(
    ("images", "coverage", "message"),
    [
        ((np.ones((4, 5, 3)),), (), "expected a coverage per image, found 0 for 1"),
        ((np.ones((4, 5, 4)),), (np.ones((4, 5)),), r"view 0: expected an image .* found \(4, 5, 4\) with \(4, 5\)"),
        ((np.ones((4, 5)),), (np.full((4, 5), 1.5),), r"expected coverage in \[0, 1\], found 1\.5"),
        ((np.ones((4, 5)),), (np.full((4, 5), np.nan),), r"expected coverage in \[0, 1\], found nan"),
    ],
)
def test_images_that_are_none_are_refused(images: tuple, coverage: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Images(images, coverage)


# ---- the quick score of curves ----


def test_the_quick_score_is_the_full_one_without_ssim_and_lpips(guess: Predictions, truth: Predictions) -> None:
    full, quick = score(guess, truth, PAPER).metrics, score_quick(guess, truth, PAPER)
    assert list(quick) == [
        "albedo_psnr",
        "aligned_albedo_psnr",
        "view_synthesis_psnr",
        "relighting_psnr",
        "roughness_mse",
    ]
    for column, value in quick.items():
        component, name = column.rsplit("_", 1)
        assert value == full[component][name]


def test_the_quick_score_leaves_out_what_is_not_given(guess: Predictions, truth: Predictions) -> None:
    quick = score_quick(Predictions(albedo=guess.albedo), truth, PAPER)
    assert [column for column, value in quick.items() if value is None] == [
        "view_synthesis_psnr",
        "relighting_psnr",
        "roughness_mse",
    ]
