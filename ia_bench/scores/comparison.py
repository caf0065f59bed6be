"""How the two pictures of a view become comparable, as :class:`ia_bench.scores.protocol.ComparisonSettings` says.

Of the *object* alone: clip linear values to [0, 1], encode them, and paint white what the mask leaves out.

As *whole images*, as other papers compare them, in this order:

1. *Rescale* (``rescale=per_channel``): s_c = <predicted_c, true_c> / <predicted_c, predicted_c> over the scored, eroded pixels,
   in linear values, for every image on its own; 1 for a channel that is black there.
2. *Clip* linear values to [0, 1] and *encode* them.
3. *Compose*: w x + (1 - w) background, with w the eroded mask, each picture's own coverage, or the true coverage.
4. *Measure* over all pixels.

Every function raises NoScoredPixel for a view without a scored pixel, and Undefined where the prediction is NaN or infinite in
one. The first comes first, since it is the same for every prediction: nothing but two equal backgrounds would be compared.
"""

from __future__ import annotations

import numpy as np

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined
from ia_bench.scores.predictions import Pair
from ia_bench.scores.protocol import ComparisonSettings, Encoding, Protocol

BLACK = 1e-6  # sum of squares of a channel that no factor brings to the truth
GREY = 0.5


def pictures(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare two pictures in an encoding, of the object alone or as whole images."""
    settings = protocol.comparison
    if settings.area == "object":
        _expect_finite(view, view.mask)
        predicted, true, clipped = _encoded(view, encoding)
        return Compared.of_object(predicted, true, view.mask, protocol, clipped)
    scored = _eroded(view.mask, settings.erosion)
    _expect_finite(view, scored, everywhere=True)
    predicted, true, clipped = _encoded(view, encoding, _scale(view, scored, settings))
    return _whole(view, protocol, scored, (predicted, true), clipped)


def linear_pictures(view: Pair, protocol: Protocol) -> Compared:
    """Compare linear values up to ``comparison.hdr_clip``, both pictures brightened alike (Stanford-ORB's PSNR-H).

    Both are first multiplied by mean(sRGB(clip(true))) / mean(clip(true)) over the image, where clip is to [0, 1].
    """
    settings = protocol.comparison
    assert settings.hdr_clip is not None
    scored = _eroded(view.mask, settings.erosion)
    _expect_finite(view, scored, everywhere=True)
    shown = (view.true * scored[..., None]).clip(0, 1)
    gain = linear_to_srgb(shown).mean() / shown.mean() if shown.mean() > 1e-8 else 1.0
    predicted, cut_predicted = _clip(view.predicted * _scale(view, scored, settings) * gain, settings.hdr_clip, view.mask)
    true, cut_true = _clip(view.true * gain, settings.hdr_clip, view.mask)
    return _whole(view, protocol, scored, (predicted, true), (cut_predicted, cut_true))


def over_white(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare all known pixels, as most papers print it: both pictures lie over white by their own coverage."""
    _expect_finite(view, view.mask, everywhere=True)
    predicted, true, clipped = _encoded(view, encoding)
    own, other = (coverage[..., None].clip(0, 1) for coverage in view.coverage)
    pair = own * predicted + (1 - own), other * true + (1 - other)
    return Compared(*pair, view.known, protocol, whole=True, clipped=clipped)


def roughness(view: Pair, protocol: Protocol) -> Compared:
    """Compare roughness as it is: over the object, or over a whole image with the background's grey around the object."""
    whole = protocol.comparison.area == "image"
    scored = _eroded(view.mask, protocol.comparison.erosion)
    _expect_finite(view, scored, everywhere=whole)
    if not whole:
        return Compared(view.predicted, view.true, view.mask, protocol)
    pair = _composed(view, protocol.comparison, scored, (view.predicted, view.true))
    return Compared(*pair, view.known, protocol, whole=True)


def _expect_finite(view: Pair, scored: np.ndarray, *, everywhere: bool = False) -> None:
    """``everywhere``: in any pixel of the picture, since no weight, not even 0, takes NaN out of a mean."""
    if not scored.any():
        raise NoScoredPixel
    finite = np.isfinite(view.predicted)
    broken = ~(finite if finite.ndim == 2 else finite.all(-1))
    if count := int((broken if everywhere else broken & view.mask).sum()):
        raise Undefined(f"the prediction is not finite in {count}{'' if everywhere else ' scored'} pixels")


def _encoded(view: Pair, encoding: Encoding, scale: np.ndarray | float = 1.0) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Prediction times ``scale``, and truth, both encoded and clipped to [0, 1]; and how many values of each were clipped."""
    predicted, cut_predicted = encode(view.predicted * scale, encoding, view.mask)
    true, cut_true = encode(view.true, encoding, view.mask)
    return predicted, true, (cut_predicted, cut_true)


def encode(linear: np.ndarray, encoding: Encoding, inside: np.ndarray) -> tuple[np.ndarray, int]:
    """Encode (H, W, 3) linear values and clip them to [0, 1]; also the number of values ``inside`` (H, W) clipped."""
    return _clip(linear_to_srgb(linear) if encoding == "srgb" else linear, 1.0, inside)


def _clip(values: np.ndarray, largest: float, inside: np.ndarray) -> tuple[np.ndarray, int]:
    beyond = ((values < 0) | (values > largest)) & inside[..., None]
    return np.clip(values, 0.0, largest), int(beyond.sum())


def _whole(
    view: Pair, protocol: Protocol, scored: np.ndarray, pair: tuple[np.ndarray, np.ndarray], clipped: tuple[int, int]
) -> Compared:
    """Both pictures over the background, and the grey object that is the floor of PSNR."""
    settings = protocol.comparison
    over = _composed(view, settings, scored, pair)
    grey = _composed(view, settings, scored, (np.full(pair[0].shape, GREY), pair[1]))[0] if settings.floor else None
    return Compared(*over, view.known, protocol, whole=True, grey=grey, clipped=clipped)


def _composed(
    view: Pair, settings: ComparisonSettings, scored: np.ndarray, pair: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and truth, (H, W) or (H, W, 3), over the background."""
    mask = scored.astype(np.float64)
    own, true = (coverage.clip(0, 1) for coverage in view.coverage)
    weights = {"mask": (mask, mask), "own": (own, true), "truth": (true, true)}[settings.silhouette]
    over = []
    for picture, weight in zip(pair, weights, strict=True):
        weight = weight if picture.ndim == 2 else weight[..., None]
        over.append(weight * picture + (1 - weight) * settings.background)
    return over[0], over[1]


def _eroded(mask: np.ndarray, side: int) -> np.ndarray:
    """The mask (H, W) bool without what is nearer than half of ``side`` pixels to its edge; the image's border is no edge."""
    from scipy.ndimage import binary_erosion  # only other papers' protocols need it

    return binary_erosion(mask, np.ones((side, side)), border_value=1) if side else mask


def _scale(view: Pair, scored: np.ndarray, settings: ComparisonSettings) -> np.ndarray:
    """The factor of each channel (3,) that brings the prediction to the truth, or 1."""
    if settings.rescale == "none":
        return np.ones(3)
    predicted, true = view.predicted[scored].astype(np.float64), view.true[scored].astype(np.float64)
    power = (predicted**2).sum(0)
    return np.where(power > BLACK, (predicted * true).sum(0) / np.maximum(power, BLACK), 1.0)
