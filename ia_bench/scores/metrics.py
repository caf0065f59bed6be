"""PSNR, SSIM and squared error of one pair of images inside a mask.

Images are (H, W, 3) in [0, 1], already encoded and un-premultiplied; ``mask`` is (H, W) bool. Pixels outside the mask
never matter: they are left out (PSNR) or painted white in both images (SSIM, LPIPS), whose windows reach over the edge.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores.protocol import Encoding, SsimSettings

C1, C2 = 0.01**2, 0.03**2  # of SSIM, for a data range of 1


class Undefined(Exception):
    """A number that does not exist for this input; the message is the reason that is stored beside the null."""


class NoScoredPixel(Undefined):
    """The mask is empty: there is nothing to compare, whatever the prediction."""

    def __init__(self) -> None:
        """Carry the one reason there is."""
        super().__init__("no scored pixel")


def encode(linear: np.ndarray, encoding: Encoding, inside: np.ndarray) -> tuple[np.ndarray, int]:
    """Encode (H, W, 3) linear values and clip them to [0, 1]; also the number of values ``inside`` (H, W) clipped."""
    return clipped(linear_to_srgb(linear) if encoding == "srgb" else linear, 1.0, inside)


def clipped(values: np.ndarray, largest: float, inside: np.ndarray) -> tuple[np.ndarray, int]:
    """Clip (H, W, 3) values to [0, largest]; also how many of those ``inside`` (H, W) that changes."""
    beyond = ((values < 0) | (values > largest)) & inside[..., None]
    return np.clip(values, 0.0, largest), int(beyond.sum())


def white_outside(image: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the image with everything outside ``inside`` (H, W) painted white."""
    return np.where(inside[..., None], image, 1.0)


def squared_error(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray) -> float:
    """Mean of (predicted - true)^2 over the mask's pixels (and channels).

    Raises :class:`NoScoredPixel` on an empty mask.
    """
    if not mask.any():
        raise NoScoredPixel
    return float(np.square(predicted[mask].astype(np.float64) - true[mask].astype(np.float64)).mean())


def psnr(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray) -> float:
    """Peak signal-to-noise ratio -10 log10(MSE) in dB, peak 1; +inf for images that are identical inside the mask."""
    error = squared_error(predicted, true, mask)
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def ssim(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray, settings: SsimSettings) -> float:
    """Structural similarity map of the white-filled images, averaged over the mask's pixels and channels.

    As scikit-image computes it with a Gaussian window and population covariance, with all channels in one filter: at the size of
    our images its calls for each moment and channel take longer than their arithmetic.

    Raises :class:`Undefined` on an image smaller than the window, :class:`NoScoredPixel` on an empty mask.
    """
    if not mask.any():
        raise NoScoredPixel
    if min(mask.shape) < settings.window:
        size = f"{mask.shape[1]} x {mask.shape[0]}"
        raise Undefined(f"image of {size} pixels is smaller than the window of {settings.window}")
    seen = tuple(_reach(places, settings.window) for places in np.nonzero(mask))  # no window of a scored pixel looks farther
    mask = mask[seen]
    x, y = (white_outside(image[seen], mask) for image in (predicted, true))
    return float(similarity(x, y, settings)[mask].mean())


def similarity(predicted: np.ndarray, true: np.ndarray, settings: SsimSettings) -> np.ndarray:
    """The SSIM map (H, W, 3) of two images (H, W, 3), which are mirrored at their borders."""
    from scipy.ndimage import gaussian_filter  # only the scores of a whole run need it

    x, y = (image.astype(np.float64) for image in (predicted, true))
    reach = settings.window // 2
    blur = partial(gaussian_filter, sigma=(0, settings.sigma, settings.sigma, 0), radius=(0, reach, reach, 0))
    mean_x, mean_y, xx, yy, xy = blur(np.stack([x, y, x * x, y * y, x * y]))
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    structure = (2 * (xy - mean_x * mean_y) + C2) / (xx - mean_x**2 + yy - mean_y**2 + C2)
    return luminance * structure


def _reach(places: np.ndarray, window: int) -> slice:
    """From a ``window`` before the first of some rows or columns to a window behind the last one."""
    return slice(max(int(places.min()) - window, 0), int(places.max()) + window + 1)
