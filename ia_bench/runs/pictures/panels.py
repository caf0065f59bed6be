"""Rendered arrays as pictures: what covers a pixel, at one exposure, on grey, cut out around the object."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from PIL import Image

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import display, straight

GREY = 0.5  # behind objects, display-encoded: white paint and sails are seen on it, and black ones
CUT_MARGIN = 2  # pixels around an object that is cut out


def exposure(images: Iterable[np.ndarray], masks: Iterable[np.ndarray]) -> float:
    """The factor that brings all but the brightest hundredth of the foreground into [0, 1]; 1 without a foreground.

    One for all ``images`` (H, W, 3) with their ``masks`` (H, W), which may differ in size.
    """
    parts = [image[mask > 0.5].max(-1, initial=0.0) for image, mask in zip(images, masks, strict=True)]
    if not any(map(len, parts)):
        return 1.0
    return 1 / max(float(np.quantile(np.concatenate(parts), 0.99)), 1e-12)


def on_grey(picture: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) in [0, 1] over GREY, (H, W, 3)."""
    alpha = coverage[..., None].clip(0, 1)
    return np.broadcast_to(alpha * picture + (1 - alpha) * GREY, (*coverage.shape, 3))


def displayed(image: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """What covers each pixel of a linear premultiplied image (H, W, 3), as on a display, over GREY."""
    return on_grey(display(image, coverage), coverage)


def plain(values: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """What covers each pixel of a premultiplied map (H, W), black is 0, over GREY."""
    return on_grey(straight(values[..., None], coverage).clip(0, 1), coverage)


def extent(mask: np.ndarray) -> int:
    """Side in pixels of the smallest square around what ``mask`` (H, W) covers, with a margin; 1 where it covers nothing."""
    lengths = [np.ptp(found) + 1 + 2 * CUT_MARGIN for found in np.nonzero(mask > 0) if len(found)]
    return int(max(lengths, default=1))


def cut_out(picture: np.ndarray, mask: np.ndarray, side: int, beyond: float = GREY) -> np.ndarray:
    """The square (side, side, C) of ``picture`` (H, W, C) around what ``mask`` (H, W) covers; ``beyond`` is past its edges."""
    padded = np.pad(picture, ((side, side), (side, side), (0, 0)), constant_values=beyond)
    starts = [(found.min() + found.max() + 1 - side) // 2 + side if len(found) else side for found in np.nonzero(mask > 0)]
    return padded[starts[0] : starts[0] + side, starts[1] : starts[1] + side]


def light_map(radiance: np.ndarray, gain: float) -> np.ndarray:
    """A lat-long light (H, W, 3) at an exposure, as on a display."""
    return linear_to_srgb((gain * radiance).clip(0, 1))


def light_exposure(radiance: np.ndarray) -> float:
    """The factor that brings nine tenths of a light (H, W, 3) below mid-grey."""
    return 0.5 / max(float(np.quantile(radiance.mean(-1), 0.9)), 1e-12)


def to_image(picture: np.ndarray) -> Image.Image:
    """Make a picture of eight bits from display-encoded values (H, W, 3) in [0, 1]."""
    return Image.fromarray(np.round(255 * picture).astype(np.uint8))
