"""PSNR, SSIM and squared error against scikit-image and closed forms; the mask, tiny and identical images."""

import numpy as np
import pytest
from skimage.draw import disk
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined, psnr, squared_error, ssim

HEIGHT, WIDTH = 37, 43  # larger than the SSIM window, and not square
RANDOM = np.random.default_rng(0)
TRUE, GUESS = RANDOM.random((HEIGHT, WIDTH, 3)), RANDOM.random((HEIGHT, WIDTH, 3))
EVERYWHERE, NOWHERE = np.ones((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH), bool)
DISC = NOWHERE.copy()
DISC[disk((18, 21), 12)] = True

of = Compared.of_object


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
