"""Pictures that are compared as whole images, as other papers compare them: the object over a background, all pixels alike.

:class:`ia_bench.scores.protocol.ComparisonSettings` says how. The steps, in this order:

1. *Rescale* (``rescale=per_channel``): s_c = <predicted_c, true_c> / <predicted_c, predicted_c> over the scored, eroded pixels,
   in linear values, for every image on its own; 1 for a channel that is black there.
2. *Clip* linear values to [0, 1] and *encode* them.
3. *Compose*: w x + (1 - w) background, with w the eroded mask, each picture's own coverage, or the true coverage.
4. *Measure* over all pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores import metrics
from ia_bench.scores.perceptual import lpips_whole
from ia_bench.scores.predictions import Pair
from ia_bench.scores.protocol import ComparisonSettings, Encoding, LpipsSettings, SsimSettings

BLACK = 1e-6  # sum of squares of a channel that no factor brings to the truth
GREY = 0.5


@dataclass(frozen=True)
class WholeImages:
    """Two composed images (H, W, 3), and what their metrics need.

    Attributes:
        predicted: Encoded, over the background.
        true: The same of the truth.
        known: (H, W) bool, pixels that the truth knows.
        grey: An object of the grey .5 in place of the prediction, over the same background, where PSNR has it as its floor;
            else None.
        clipped: How many values of scored pixels were clipped, in prediction and truth.
    """

    predicted: np.ndarray
    true: np.ndarray
    known: np.ndarray
    grey: np.ndarray | None
    clipped: tuple[int, int]

    def psnr(self) -> float:
        """PSNR over all known pixels, no less than that of the grey object where there is one."""
        value = metrics.psnr(self.predicted, self.true, self.known)
        return value if self.grey is None else max(value, metrics.psnr(self.grey, self.true, self.known))

    def ssim(self, settings: SsimSettings) -> float:
        """Mean of the SSIM map, of all pixels or of those whose window lies within the image."""
        if min(self.known.shape) < settings.window:
            raise metrics.Undefined(f"image smaller than the window of {settings.window} pixels")
        found = metrics.similarity(self.predicted, self.true, settings)
        reach = settings.window // 2 if settings.border == "valid" else 0
        return float(found[reach : len(found) - reach, reach : found.shape[1] - reach].mean())

    def lpips(self, settings: LpipsSettings, comparison: ComparisonSettings) -> float:
        """LPIPS of the whole images, encoded once more where the protocol does so."""
        pair = (self.predicted, self.true)
        if comparison.lpips_encoded_again:
            pair = (linear_to_srgb(self.predicted), linear_to_srgb(self.true))
        return lpips_whole(*pair, settings)


def whole_images(view: Pair, encoding: Encoding, comparison: ComparisonSettings) -> WholeImages:
    """The two pictures of a view as they are compared."""
    scored = eroded(view.mask, comparison.erosion)
    scale = _scale(view, scored, comparison)
    predicted, clipped_predicted = metrics.encode(view.predicted * scale, encoding, view.mask)
    true, clipped_true = metrics.encode(view.true, encoding, view.mask)
    pair = composed(view, comparison, (predicted, true))
    return WholeImages(*pair, view.known, _grey(view, comparison), (clipped_predicted, clipped_true))


def linear_images(view: Pair, comparison: ComparisonSettings) -> WholeImages:
    """The two pictures in linear values up to ``comparison.hdr_clip``, brightened alike (Stanford-ORB's PSNR-H).

    Both are first multiplied by mean(sRGB(clip(true))) / mean(clip(true)) over the image, where clip is to [0, 1].
    """
    assert comparison.hdr_clip is not None
    scored = eroded(view.mask, comparison.erosion)
    shown = (view.true * scored[..., None]).clip(0, 1)
    gain = linear_to_srgb(shown).mean() / shown.mean() if shown.mean() > 1e-8 else 1.0
    scale = _scale(view, scored, comparison)
    predicted, clipped_predicted = metrics.clipped(view.predicted * scale * gain, comparison.hdr_clip, view.mask)
    true, clipped_true = metrics.clipped(view.true * gain, comparison.hdr_clip, view.mask)
    pair = composed(view, comparison, (predicted, true))
    return WholeImages(*pair, view.known, _grey(view, comparison), (clipped_predicted, clipped_true))


def composed(view: Pair, comparison: ComparisonSettings, pair: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and truth, (H, W) or (H, W, 3), over the background."""
    scored = eroded(view.mask, comparison.erosion).astype(np.float64)
    own, true = (coverage.clip(0, 1) for coverage in view.coverage)
    shares = {"mask": (scored, scored), "own": (own, true), "truth": (true, true)}[comparison.silhouette]
    over = []
    for picture, share in zip(pair, shares, strict=True):
        weight = share if picture.ndim == 2 else share[..., None]
        over.append(weight * picture + (1 - weight) * comparison.background)
    return over[0], over[1]


def eroded(mask: np.ndarray, side: int) -> np.ndarray:
    """The mask (H, W) bool without what is nearer than half of ``side`` pixels to its edge; the image's border is no edge."""
    from scipy.ndimage import binary_erosion  # only other papers' protocols need it

    return binary_erosion(mask, np.ones((side, side)), border_value=1) if side else mask


def _scale(view: Pair, scored: np.ndarray, comparison: ComparisonSettings) -> np.ndarray:
    """The factor of each channel (3,) that brings the prediction to the truth, or 1."""
    if comparison.rescale == "none":
        return np.ones(3)
    predicted, true = view.predicted[scored].astype(np.float64), view.true[scored].astype(np.float64)
    power = (predicted**2).sum(0)
    return np.where(power > BLACK, (predicted * true).sum(0) / np.maximum(power, BLACK), 1.0)


def _grey(view: Pair, comparison: ComparisonSettings) -> np.ndarray | None:
    """The prediction with GREY in all channels (H, W, 3), over the background; None where PSNR has no floor."""
    if not comparison.floor:
        return None
    return composed(view, comparison, (np.full(view.predicted.shape, GREY), view.true))[0]
