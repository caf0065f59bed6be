"""The metrics: functions of two pictures as a protocol compares them. A metric is one function, and one line of ``columns.py``."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ia_bench.scores.protocol import Protocol, SsimSettings

C1, C2 = 0.01**2, 0.03**2  # of SSIM, for a data range of 1


class Undefined(Exception):
    """A number that does not exist for this input; the message is the reason that is stored beside the null."""


class NoScoredPixel(Undefined):
    """The mask is empty: there is nothing to compare, whatever the prediction."""

    def __init__(self) -> None:
        """Carry the one reason there is."""
        super().__init__("no scored pixel")


@dataclass(frozen=True)
class Compared:
    """Two pictures of one view as they are compared (:mod:`ia_bench.scores.comparison` makes them).

    Attributes:
        predicted: (H, W, 3), or (H, W) of roughness, encoded and clipped.
        true: The same of the truth.
        area: (H, W) bool, the pixels that means are taken over.
        protocol: Its settings of SSIM and LPIPS are read.
        whole: Whether the pictures are compared as whole images. If not, both are white outside of ``area``, so that windows
            that reach over its edge find the same there.
        grey: The picture whose PSNR is the least that counts, None for no such floor.
        clipped: How many values of scored pixels were clipped, in prediction and truth.
    """

    predicted: np.ndarray
    true: np.ndarray
    area: np.ndarray
    protocol: Protocol = field(default_factory=Protocol)
    whole: bool = False
    grey: np.ndarray | None = None
    clipped: tuple[int, int] = (0, 0)

    @classmethod
    def of_object(
        cls,
        predicted: np.ndarray,
        true: np.ndarray,
        mask: np.ndarray,
        protocol: Protocol | None = None,
        clipped: tuple[int, int] = (0, 0),
    ) -> Compared:
        """Compare the pixels of ``mask`` (H, W) alone: everything else is painted white in both pictures (H, W, 3)."""
        inside = mask[..., None]
        return cls(np.where(inside, predicted, 1.0), np.where(inside, true, 1.0), mask, protocol or Protocol(), clipped=clipped)

    def expect_windows(self, side: int) -> None:
        """Raise Undefined for pictures that a window of ``side`` pixels does not fit into, NoScoredPixel for an empty area."""
        if not self.area.any():
            raise NoScoredPixel
        height, width = self.area.shape
        if min(height, width) < side:
            raise Undefined(f"image of {width} x {height} pixels is smaller than the window of {side}")


def squared_error(pair: Compared) -> float:
    """Mean of (predicted - true)^2 over the area's pixels and channels. Raises NoScoredPixel on an empty area."""
    return _squared_error(pair.predicted, pair.true, pair.area)


def psnr(pair: Compared) -> float:
    """Peak signal-to-noise ratio -10 log10(MSE) in dB, peak 1; +inf for pictures that are identical in the area.

    It is no less than that of ``pair.grey``, where the protocol has such a floor. Raises NoScoredPixel on an empty area.
    """
    errors = [_squared_error(shown, pair.true, pair.area) for shown in (pair.predicted, pair.grey) if shown is not None]
    return float("inf") if min(errors) == 0 else -10.0 * float(np.log10(min(errors)))


def ssim(pair: Compared) -> float:
    """Structural similarity (Wang et al. 2004), the mean of its map over pixels and channels.

    The pixels are those of the area; of whole images all, or all whose window lies within the picture (``ssim.border=valid``). As
    scikit-image computes it with a Gaussian window and population covariance, with all channels in one filter: at the size of
    our images its calls for each moment and channel take longer than their arithmetic.

    Raises Undefined on pictures smaller than the window, NoScoredPixel on an empty area.
    """
    settings = pair.protocol.ssim
    pair.expect_windows(settings.window)
    if pair.whole:
        found = _similarity(pair.predicted, pair.true, settings)
        border = settings.window // 2 if settings.border == "valid" else 0
        return float(found[border : len(found) - border, border : found.shape[1] - border].mean())
    seen = tuple(_reach(places, settings.window) for places in np.nonzero(pair.area))  # no window of a scored pixel looks farther
    return float(_similarity(pair.predicted[seen], pair.true[seen], settings)[pair.area[seen]].mean())


def _squared_error(predicted: np.ndarray, true: np.ndarray, area: np.ndarray) -> float:
    if not area.any():
        raise NoScoredPixel
    return float(np.square(predicted[area].astype(np.float64) - true[area].astype(np.float64)).mean())


def _similarity(predicted: np.ndarray, true: np.ndarray, settings: SsimSettings) -> np.ndarray:
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
    """The range from a ``window`` before the first of some rows or columns to a window behind the last one."""
    return slice(max(int(places.min()) - window, 0), int(places.max()) + window + 1)
