"""Rendered arrays as pictures: what covers a pixel, at one exposure, on white."""

from __future__ import annotations

import numpy as np
from PIL import Image


def exposure(images: np.ndarray, masks: np.ndarray) -> float:
    """Brings all but the brightest hundredth of the foreground into [0, 1]; 1 where there is no foreground."""
    brightest = images[masks > 0.5].max(-1, initial=0.0)
    return 1 / max(float(np.quantile(brightest, 0.99)), 1e-12) if len(brightest) else 1.0


def unmultiplied(image: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """What covers the pixel, (H, W, C) in [0, 1]."""
    return (image / np.maximum(coverage, 1e-3)[..., None]).clip(0, 1)


def on_white(picture: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) in [0, 1] over white, (H, W, 3)."""
    alpha = coverage[..., None].clip(0, 1)
    return np.broadcast_to(alpha * picture + (1 - alpha), (*coverage.shape, 3))


def to_image(picture: np.ndarray) -> Image.Image:
    """(H, W, 3) in [0, 1], display-encoded, as eight bits."""
    return Image.fromarray(np.round(255 * picture).astype(np.uint8))
