"""Alignments against closed forms, against numpy's least squares, and on what no scale can repair."""

import numpy as np
import pytest

from ia_bench.scores.comparison import ALIGNMENTS, scale
from ia_bench.scores.metrics import Undefined

RANDOM = np.random.default_rng(0)
TRUE, PREDICTED = 0.1 + 0.8 * RANDOM.random((101, 3)), 0.1 + 0.8 * RANDOM.random((101, 3))
SCALED = [name for name in ALIGNMENTS if name != "none"]


@pytest.mark.parametrize("name", SCALED)
@pytest.mark.parametrize("factor", [0.01, 7.5])
def test_a_scaled_truth_is_scaled_back(name: str, factor: float) -> None:
    np.testing.assert_allclose(scale(name, TRUE * factor, TRUE), np.full(3, 1 / factor), rtol=1e-12)


def test_least_squares_agrees_with_numpy_and_a_median_ignores_outliers() -> None:
    expected = np.linalg.lstsq(PREDICTED.reshape(-1, 1), TRUE.ravel(), rcond=None)[0]
    np.testing.assert_allclose(scale("least_squares", PREDICTED, TRUE), np.full(3, expected), rtol=1e-12)
    predicted = TRUE * np.array([2.0, 1.0, 0.5])
    predicted[:40] = 1e-9
    np.testing.assert_allclose(scale("median_ratio", predicted, TRUE), [0.5, 1.0, 2.0], rtol=1e-12)


def test_a_colour_cast_is_hidden_by_per_channel_alignment_alone() -> None:
    cast = np.array([1.5, 1.0, 0.6])
    np.testing.assert_allclose(scale("per_channel", TRUE * cast, TRUE) * cast, np.ones(3), rtol=1e-12)
    for alignment in ("mean_rgb", "least_squares"):
        left = scale(alignment, TRUE * cast, TRUE) * cast
        np.testing.assert_allclose(left / left[1], cast, rtol=1e-12)


@pytest.mark.parametrize("name", SCALED)
@pytest.mark.parametrize(
    ("predicted", "true", "reason"),
    [
        (np.zeros((5, 3)), TRUE[:5], "no positive scale"),
        (-TRUE[:5], TRUE[:5], "no positive scale"),
        (TRUE[:5], np.zeros((5, 3)), "no positive scale"),
        (np.full((5, 3), np.inf), TRUE[:5], "not finite"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "no scored pixel"),
    ],
)
def test_where_no_scale_exists_a_reason_does(name: str, predicted: np.ndarray, true: np.ndarray, reason: str) -> None:
    with pytest.raises(Undefined, match=reason):
        scale(name, predicted, true)
