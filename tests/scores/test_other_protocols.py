"""The protocols of other papers on made-up images, against numbers worked out by hand from what those papers' programs do.

Of TensoIR's in part: docs/protocol.md says what it does otherwise. The object is a square of 20 x 20 pixels in an image of
40 x 40, with a dark part and a bright part of one value each.
"""

import math

import numpy as np
import pytest

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.scenes.images import Images
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.evaluate import Scores, score
from ia_bench.scores.protocol import ComparisonSettings, Protocol, shipped

pytestmark = pytest.mark.usefixtures("mean_square_as_lpips")

SIDE, FROM, TO = 40, 10, 30
PIXELS = SIDE * SIDE


def two_parts(dark: float, bright: float, columns: int = 10, *, coverage: np.ndarray | None = None, grey: bool = False) -> Images:
    """One premultiplied image: the first ``columns`` of the square are dark, the others bright."""
    inside = np.zeros((SIDE, SIDE))
    inside[FROM:TO, FROM:TO] = 1
    coverage = inside if coverage is None else coverage
    values = np.where(np.arange(SIDE) < FROM + columns, dark, bright) * coverage
    return Images((values if grey else np.repeat(values[..., None], 3, -1),), (coverage,))


def curve(linear: float) -> float:
    """IEC 61966-2-1 above its linear part."""
    return 1.055 * linear ** (1 / 2.4) - 0.055


def decibel(*errors: tuple[int, float]) -> float:
    """PSNR of so many pixels of the whole image that are off by so much each, all others right."""
    return -10 * math.log10(sum(count * error**2 for count, error in errors) / PIXELS)


def scored(name: str, predicted: Predictions, true: Predictions) -> Scores:
    return score(predicted, true, shipped(name))


def test_tensoir() -> None:
    """Albedo: medians of the ratio over 240 dark pixels (2) and 160 bright ones (1.2) are 2, so bright ones become 1.0, not .6."""
    true, guess = two_parts(0.2, 0.6, 12), two_parts(0.1, 0.5, 12)
    found = scored("tensoir", Predictions(albedo=guess, view_synthesis=guess), Predictions(albedo=true, view_synthesis=true))
    assert found.albedo_scales["median_ratio"] == pytest.approx([2, 2, 2])
    assert found.metrics["aligned_albedo"]["psnr"] == pytest.approx(decibel((160, 0.4)))
    assert found.metrics["aligned_albedo"]["lpips"] == pytest.approx(160 * 0.16 / PIXELS)
    assert found.metrics["albedo"]["psnr"] == pytest.approx(decibel((400, 0.1)))
    errors = (240, curve(0.2) - curve(0.1)), (160, curve(0.6) - curve(0.5))
    assert found.metrics["view_synthesis"]["psnr"] == pytest.approx(decibel(*errors))


def test_tensoir_leaves_out_the_border_of_ssim() -> None:
    """Windows of 11 x 11 pixels lie within 30 x 30 places; pictures that differ everywhere equally have one value in all."""
    ones = np.ones((SIDE, SIDE))
    flat = [Images((np.full((SIDE, SIDE, 3), value),), (ones,)) for value in (0.2, 0.4)]
    found = scored("tensoir", Predictions(albedo=flat[1]), Predictions(albedo=flat[0]))
    expected = (2 * 0.2 * 0.4 + 0.01**2) / (0.2**2 + 0.4**2 + 0.01**2)
    assert found.metrics["albedo"]["ssim"] == pytest.approx(expected)


@pytest.mark.parametrize("name", ["tensoir", "synthetic4relight", "stanford-orb"])
def test_pixels_that_nobody_knows_are_the_same_in_all_measures_of_whole_images(name: str) -> None:
    known = np.ones((SIDE, SIDE), bool)
    known[5:15, 5:15] = False
    true = Images((np.full((SIDE, SIDE, 3), 0.5),), (np.ones((SIDE, SIDE)),), (known,))
    found = [np.where(known[..., None], np.full(3, 0.5), value) for value in (0.0, 0.5, 1.0)]
    guesses = [Predictions(view_synthesis=Images((image,), true.coverage)) for image in found]
    scores = [scored(name, guess, Predictions(view_synthesis=true)).metrics["view_synthesis"] for guess in guesses]
    assert scores[0] == scores[1] == scores[2]
    assert (scores[0]["psnr"], scores[0]["ssim"]) == (math.inf, pytest.approx(1))


def test_synthetic4relight() -> None:
    """Both pictures are cut out by the true coverage, and roughness is averaged over the white background, too."""
    true = two_parts(0.2, 0.6)
    half = two_parts(0.1, 0.5, coverage=0.5 * true.coverage[0])
    rough, guess = two_parts(0.5, 0.5, grey=True), two_parts(0.2, 0.8, grey=True)
    found = scored(
        "synthetic4relight",
        Predictions(albedo=half, view_synthesis=half, roughness=guess),
        Predictions(albedo=true, view_synthesis=true, roughness=rough),
    )
    assert found.metrics["roughness"]["mse"] == pytest.approx(0.09 * 400 / PIXELS)
    errors = (200, curve(0.2) - curve(0.1)), (200, curve(0.6) - curve(0.5))
    assert found.metrics["view_synthesis"]["psnr"] == pytest.approx(decibel(*errors))
    assert found.metrics["albedo"]["psnr"] == pytest.approx(decibel((400, 0.1)))


def test_stanford_orb() -> None:
    """A square of 20 loses two pixels at each edge: 8 columns of each part of 16 pixels, scaled by .32 / .26."""
    true, guess = two_parts(0.2, 0.6), two_parts(0.1, 0.5)
    found = scored("stanford-orb", Predictions(albedo=guess, view_synthesis=guess), Predictions(albedo=true, view_synthesis=true))
    dark, bright = 0.1 * 0.32 / 0.26, 0.5 * 0.32 / 0.26
    encoded = (128, curve(0.2) - curve(dark)), (128, curve(0.6) - curve(bright))
    assert found.metrics["view_synthesis"]["psnr"] == pytest.approx(decibel(*encoded))
    assert found.metrics["albedo"]["psnr"] == pytest.approx(decibel((128, 0.2 - dark), (128, 0.6 - bright)))
    again = (128, curve(curve(0.2)) - curve(curve(dark))), (128, curve(curve(0.6)) - curve(curve(bright)))
    lpips = sum(count * error**2 for count, error in again) / PIXELS
    assert found.metrics["view_synthesis"]["lpips"] == pytest.approx(lpips)
    gain = (curve(0.2) + curve(0.6)) / 0.8
    linear = (128, gain * (0.2 - dark)), (128, gain * (0.6 - bright))
    assert found.variants["view_synthesis_hdr"]["psnr"] == pytest.approx(decibel(*linear))


def test_stanford_orb_has_a_grey_object_as_its_floor() -> None:
    true, wrong = two_parts(0.2, 0.6), two_parts(1.0, 0.0)
    found = scored("stanford-orb", Predictions(view_synthesis=wrong), Predictions(view_synthesis=true))
    floor = decibel((128, curve(0.2) - 0.5), (128, curve(0.6) - 0.5))
    assert found.metrics["view_synthesis"]["psnr"] == pytest.approx(floor)
    black = scored("stanford-orb", Predictions(view_synthesis=two_parts(0, 0)), Predictions(view_synthesis=true))
    assert black.metrics["view_synthesis"]["psnr"] == pytest.approx(floor)


def test_settings_that_mean_nothing_are_refused() -> None:
    with pytest.raises(InputError, match="expected area=image with the other settings of whole images"):
        parsed(Protocol, {"comparison": {"erosion": 5}}, "protocol")
    with pytest.raises(InputError, match="erosion: expected 0 or an odd number, found 4"):
        ComparisonSettings(area="image", erosion=4)
    with pytest.raises(InputError, match="noise=subtracted: expected comparison.area=object, found image"):
        Protocol(noise="subtracted", comparison=ComparisonSettings(area="image"))
    border = {"noise": "kept", "ssim": {"border": "valid"}}
    with pytest.raises(InputError, match=r"^protocol\.ssim\.border=valid: expected comparison\.area=image, found object$"):
        parsed(Protocol, border, "protocol")
    parsed(Protocol, {**border, "comparison": {"area": "image"}}, "protocol")
