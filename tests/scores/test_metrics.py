"""PSNR, SSIM and squared error against scikit-image and closed forms; the mask, tiny and identical images."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.draw import disk
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores.comparison import encode
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined, psnr, squared_error, ssim

HEIGHT, WIDTH = 37, 43  # larger than the SSIM window, and not square
RANDOM = np.random.default_rng(0)
TRUE, GUESS = RANDOM.random((HEIGHT, WIDTH, 3)), RANDOM.random((HEIGHT, WIDTH, 3))
EVERYWHERE, NOWHERE = np.ones((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH), bool)
DISC = NOWHERE.copy()
DISC[disk((18, 21), 12)] = True

of = Compared.of_object


def test_srgb_meets_its_published_values() -> None:
    # The standard's 8-bit codes of linear 0, the joint of the two pieces, 0.5 (code 188) and 1.
    linear = np.array([0.0, 0.0031308, 0.5, 1.0])
    np.testing.assert_allclose(linear_to_srgb(linear), [0.0, 0.0404499, 0.7353570, 1.0], atol=1e-6)
    assert round(float(linear_to_srgb(np.array(0.5))) * 255) == 188


def test_srgb_is_undone_by_the_standards_inverse() -> None:
    encoded = linear_to_srgb(np.linspace(0, 1, 1001))
    decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(decoded, np.linspace(0, 1, 1001), atol=1e-7)


def test_clipping_is_counted_inside_the_mask_only() -> None:
    image = np.full((4, 5, 3), 0.5)
    image[0, 0] = (2.0, -1.0, 1.0)
    image[3, 4] = 9.0
    inside = np.ones((4, 5), bool)
    inside[3, 4] = False
    encoded, clipped = encode(image, "srgb", inside)
    assert clipped == 2
    assert (encoded.min(), encoded.max()) == (0.0, 1.0)
    np.testing.assert_array_equal(encode(np.full((4, 5, 3), 0.25), "linear", inside)[0], 0.25)


def test_psnr_and_error_agree_with_scikit_image() -> None:
    assert psnr(of(GUESS, TRUE, EVERYWHERE)) == pytest.approx(peak_signal_noise_ratio(TRUE, GUESS, data_range=1), abs=1e-10)
    assert squared_error(of(GUESS, TRUE, EVERYWHERE)) == pytest.approx(mean_squared_error(TRUE, GUESS), rel=1e-12)


@pytest.mark.parametrize("offset", [0.1, 0.01, -0.5])
def test_psnr_of_a_constant_offset_is_its_closed_form(offset: float) -> None:
    grey = np.full_like(TRUE, 0.5)
    assert psnr(of(grey + offset, grey, DISC)) == pytest.approx(-20 * np.log10(abs(offset)), abs=1e-9)


def test_ssim_agrees_with_scikit_image_away_from_the_border() -> None:
    # scikit-image's own mean leaves out half a window at each border: the same pixels, chosen by a mask, here.
    inner = np.zeros_like(EVERYWHERE)
    inner[5:-5, 5:-5] = True
    guess, true = np.where(inner[..., None], GUESS, 1.0), np.where(inner[..., None], TRUE, 1.0)
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    expected = structural_similarity(guess, true, channel_axis=-1, data_range=1, **options)
    assert ssim(of(GUESS, TRUE, inner)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("corner", [(0, 0), (0, -1), (-1, 0), (-1, -1), (3, 17)])
def test_ssim_looks_no_farther_than_it_must_and_no_less(corner: tuple[int, int]) -> None:
    """One scored pixel, also in a corner, where the window is reflected: what the whole image gives."""
    mask = np.zeros_like(EVERYWHERE)
    mask[corner] = True
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    guess, true = np.where(mask[..., None], GUESS, 1.0), np.where(mask[..., None], TRUE, 1.0)
    whole = structural_similarity(guess, true, channel_axis=-1, data_range=1, full=True, **options)[1]
    assert ssim(of(GUESS, TRUE, mask)) == pytest.approx(whole[corner].mean(), abs=1e-12)


def test_ssim_of_two_constants_is_its_closed_form() -> None:
    # No variance: only the luminance term is left, (2ab + c1) / (a^2 + b^2 + c1) with c1 = 0.01^2.
    a, b, c1 = 0.3, 0.6, 1e-4
    value = ssim(of(np.full_like(TRUE, a), np.full_like(TRUE, b), EVERYWHERE))
    assert value == pytest.approx((2 * a * b + c1) / (a * a + b * b + c1), abs=1e-6)


@pytest.mark.parametrize("outside", [0.0, 3.0, np.nan])
def test_what_is_outside_the_mask_changes_nothing(outside: float) -> None:
    painted = np.where(DISC[..., None], GUESS, outside)
    assert psnr(of(painted, TRUE, DISC)) == psnr(of(GUESS, TRUE, DISC))
    assert ssim(of(painted, TRUE, DISC)) == ssim(of(GUESS, TRUE, DISC))


def test_identical_images() -> None:
    assert psnr(of(TRUE, TRUE.copy(), DISC)) == float("inf")
    assert ssim(of(TRUE, TRUE.copy(), DISC)) == pytest.approx(1.0, abs=1e-12)


def test_images_smaller_than_the_window_have_no_ssim_but_a_psnr() -> None:
    small = np.ones((10, 40), bool)
    with pytest.raises(Undefined, match="image of 40 x 10 pixels is smaller than the window of 11"):
        ssim(of(GUESS[:10, :40], TRUE[:10, :40], small))
    assert psnr(of(GUESS[:10, :40], TRUE[:10, :40], small)) > 0
    assert ssim(of(GUESS[:11, :11], TRUE[:11, :11], small[:1, :11].repeat(11, axis=0))) < 1


@pytest.mark.parametrize("metric", [psnr, squared_error, ssim])
def test_an_empty_mask_has_no_number(metric: object) -> None:
    with pytest.raises(NoScoredPixel):
        metric(of(GUESS, TRUE, NOWHERE))
