"""Scores of whole predictions: independent recomputation, metamorphic relations.

LPIPS needs weights, so these tests replace the network by a closed form; test_perceptual.py tests the real one.
"""

import json

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from ia_bench.scenes.images import Images
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.evaluate import albedo_scale, score, score_quick
from ia_bench.scores.protocol import Protocol

pytestmark = pytest.mark.usefixtures("mean_square_as_lpips")

PAPER = Protocol()


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
    assert albedo_scale(guess.albedo, truth.albedo, PAPER) == pytest.approx([scale] * 3, rel=1e-12)

    rough = zip(guess.roughness.images, truth.roughness.images, truth.roughness.coverage, inside, strict=True)
    errors = [np.square((p[m] - t[m]) / c[m]).mean() for p, t, c, m in rough]
    assert scores.metrics["roughness"] == {"mse": pytest.approx(np.mean(errors), rel=1e-9)}


# ---- metamorphic relations ----
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
    assert all("_whole_image" in key for key in dirty.reasons.keys() - clean.reasons.keys())
    dirty.reasons.clear()
    clean.reasons.clear()
    assert dirty == clean


# ---- the quick score of curves ----
def test_the_quick_score_is_the_full_one_whose_dictionary_is_json(guess: Predictions, truth: Predictions) -> None:
    scores, quick = score(guess, truth, PAPER), score_quick(guess, truth, PAPER)
    assert list(quick) == ["albedo_psnr", "aligned_albedo_psnr", "view_synthesis_psnr", "relighting_psnr", "roughness_mse"]
    for column, value in quick.items():
        component, name = column.rsplit("_", 1)
        assert value == scores.metrics[component][name]
    stored = json.loads(json.dumps(scores.as_dict(), allow_nan=False))
    assert stored["protocol"] == "paper-v3 (lpips.net=squeeze)"
    assert stored["protocol_description"]["alignment"] == "mean_rgb"
    assert [len(stored["per_image"]["relighting"][light]["ssim"]) for light in ("night", "studio")] == [3, 3]
    assert np.mean(stored["per_image"]["albedo"]["ssim"]) == pytest.approx(stored["metrics"]["albedo"]["ssim"])
