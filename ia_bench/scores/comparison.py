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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import Images, straight
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined
from ia_bench.scores.protocol import ComparisonSettings, Encoding, Protocol


@dataclass(frozen=True)
class Predictions:
    """Everything that is scored of one scene; ground truth has the same form. None stands for what there is not.

    Attributes:
        albedo: (H, W, 3) of the test views.
        roughness: (H, W) of the test views.
        view_synthesis: (H, W, 3) radiance under the training light.
        relighting: The same per novel light, rendered with the *aligned* albedo.
        light: (H, W, 3) radiance of balls under the recovered light (:func:`ia_bench.scores.balls.ball_pictures`).
        log_light: (H, W, 3), its log (:func:`ia_bench.scores.balls.log_radiance`).
        metallic: (H, W) of the test views.
        undefined: Component -> why there is none of it although it was predicted.
    """

    albedo: Images | None = None
    roughness: Images | None = None
    view_synthesis: Images | None = None
    relighting: Mapping[str, Images] | None = None
    light: Images | None = None
    log_light: Images | None = None
    metallic: Images | None = None
    undefined: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Pair:
    """One view, un-premultiplied.

    Attributes:
        predicted: Linear (H, W[, 3]).
        true: The same of the truth.
        mask: (H, W), True where scored: where the object is, and the truth known.
        known: (H, W), True where the truth is known.
        coverage: (H, W) each, of prediction and truth. What the prediction does not cover counts as black.
        spread: Half the difference of two estimates of the prediction, linear (H, W, 3); None of what has no noise.
        parts: The parts of the squared error (:mod:`ia_bench.scores.error_split`); nothing where it is not split.
    """

    predicted: np.ndarray
    true: np.ndarray
    mask: np.ndarray
    known: np.ndarray
    coverage: tuple[np.ndarray, np.ndarray]
    spread: np.ndarray | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Pairs(Sequence[Pair]):
    """The views of predictions and truth, paired by position; a pair is made when it is asked for, since all take gigabytes.

    Attributes:
        predicted: What is scored, of every view.
        true: The truth of these views.
        mask_threshold: Coverage above which a pixel is scored.
        what: Names the component in errors.
        factor: Multiplies the prediction, (3,) or one number.
        parts: Those of every pair; nothing where the error is not split.

    Raises ValueError where the two sets differ in number or shape; and a pair does where its truth is not finite in a scored pixel.
    """

    predicted: Images
    true: Images
    mask_threshold: float
    what: str
    factor: np.ndarray | float = 1.0
    parts: tuple[Mapping[str, float], ...] = ()

    def __post_init__(self) -> None:
        if len(self.predicted) != len(self.true):
            raise ValueError(f"{self.what}: expected {len(self.true)} views, found {len(self.predicted)}")
        for index, (theirs, ours) in enumerate(zip(self.true.images, self.predicted.images, strict=True)):
            if theirs.shape != ours.shape:
                raise ValueError(f"{self.what}, view {index}: expected shape {theirs.shape}, found {ours.shape}")

    def __len__(self) -> int:
        return len(self.true)

    def __getitem__(self, index: int) -> Pair:  # type: ignore[override]  # no slices
        predicted, true = self.predicted, self.true
        theirs, coverage = true.images[index], predicted.coverage[index]
        given = None if true.known is None else true.known[index]
        known = np.ones(theirs.shape[:2], bool) if given is None else given
        mask = (true.coverage[index] > self.mask_threshold) & known
        truth = straight(theirs, true.coverage[index]).astype(np.float64)
        if not np.isfinite(truth[mask]).all():
            raise ValueError(f"{self.what}, view {index}: the ground truth is not finite")
        guess = straight(predicted.images[index], coverage).astype(np.float64) * self.factor
        half = None if predicted.spread is None else predicted.spread[index]
        spread = None if half is None else straight(half, coverage).astype(np.float64)
        parts = self.parts[index] if self.parts else {}
        return Pair(guess, truth, mask, known, (coverage, true.coverage[index]), spread, parts)


def stacked(views: Sequence[Pair]) -> tuple[np.ndarray, np.ndarray]:
    """All scored pixels of all views, predicted and true, each (N, 3): what an alignment is computed from."""
    empty = np.zeros((0, 3))
    predicted = np.concatenate([empty, *(view.predicted[view.mask] for view in views)])
    return predicted, np.concatenate([empty, *(view.true[view.mask] for view in views)])


# ---- the scale that images under unknown light cannot tell: albedo times s under light over s is the same image ----

Quotient = tuple[np.ndarray, np.ndarray]
ALIGNMENTS: dict[str, Callable[[np.ndarray, np.ndarray], Quotient]] = {
    # One scale that makes the mean over pixels *and* channels equal (the paper's): a light colour baked in stays visible.
    "mean_rgb": lambda predicted, true: (np.full(3, true.mean()), np.full(3, predicted.mean())),
    # One scale per channel, s_c = mean(true_c) / mean(predicted_c). It hides a colour cast, so it is a variant and not the score.
    "per_channel": lambda predicted, true: (true.mean(axis=0), predicted.mean(axis=0)),
    # One scale that minimises sum (s predicted - true)^2: s = <predicted, true> / <predicted, predicted>.
    "least_squares": lambda predicted, true: (np.full(3, (predicted * true).sum()), np.full(3, (predicted * predicted).sum())),
    # One scale per channel, the median over pixels of true / max(predicted, 1e-6), as TensoIR's evaluation has it; undefined where
    # half of a channel is predicted black. It hides a colour cast, too.
    "median_ratio": lambda predicted, true: (
        np.median(true / np.maximum(predicted, 1e-6), axis=0),
        (np.median(predicted, axis=0) > 0).astype(float),
    ),
    # No scale at all: albedo is compared, and relit, as it is predicted.
    "none": lambda predicted, true: (np.ones(3), np.ones(3)),
}
"""Linear values of the scored pixels of the *whole test set*, predicted and true (N, 3) float64 -> numerator and denominator (3,).

The scale is one for the test set, never one per image.
"""
VARIANTS = ("mean_rgb", "per_channel", "least_squares")
"""Alignments that are recorded beside the protocol's own."""


def scale(alignment: str, predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """The factor (3,) float64 that multiplies linear predicted albedo. Raises Undefined where there is none."""
    if not predicted.size:
        raise NoScoredPixel
    if not np.isfinite(predicted).all():
        raise Undefined("the prediction is not finite")
    numerator, denominator = ALIGNMENTS[alignment](predicted.astype(np.float64), true.astype(np.float64))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # judged on the next line
        found = numerator / denominator
    if not (np.isfinite(found) & (found > 0)).all():
        raise Undefined(f"no positive scale: the truth over the prediction is {numerator} / {denominator}")
    return found


BLACK = 1e-6  # sum of squares of a channel that no factor brings to the truth
GREY = 0.5


def pictures(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare two pictures in an encoding, of the object alone or as whole images."""
    compare = of_object if protocol.comparison.area == "object" else _whole
    return compare(view, protocol, encoding)


def of_object(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare two pictures of the object alone, under any protocol."""
    _expect_finite(view, view.mask)
    pair, clipped = _encoded(view, encoding)
    return Compared.of_object(*pair, view.mask, protocol, clipped, _spread(view, encoding))


def linear_pictures(view: Pair, protocol: Protocol) -> Compared:
    """Compare linear values up to ``comparison.hdr_clip``, both pictures brightened alike (Stanford-ORB's PSNR-H).

    Both are first multiplied by mean(sRGB(clip(true))) / mean(clip(true)) over the image, where clip is to [0, 1].
    """
    shown = (view.true * _eroded(view, protocol.comparison)[..., None]).clip(0, 1)
    gain = linear_to_srgb(shown).mean() / shown.mean() if shown.mean() > 1e-8 else 1.0
    return _whole(view, protocol, "linear", float(gain), protocol.comparison.hdr_clip or 1.0)


def over_white(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare all known pixels, as most papers print it: both pictures lie over white by their own coverage."""
    _expect_finite(view, view.mask, everywhere=True)
    (predicted, true), clipped = _encoded(view, encoding)
    own, other = (coverage[..., None].clip(0, 1) for coverage in view.coverage)
    pair, spread = (own * predicted + (1 - own), other * true + (1 - other)), _spread(view, encoding)
    return Compared(*pair, view.known, protocol, whole=True, clipped=clipped, spread=None if spread is None else own * spread)


def exposed(view: Pair, protocol: Protocol, encoding: Encoding) -> Compared:
    """Compare a render times one factor, for a photograph of unknown exposure: s = <predicted, true> / <predicted, predicted>.

    Over the linear values of the scored pixels that the render covers, all channels together; 1 for a black render. The power of
    the render's noise, which its two halves tell, is no part of the denominator.
    """
    _expect_finite(view, view.mask)
    inside = view.mask & (view.coverage[0] > 0)
    predicted, true = view.predicted[inside], view.true[inside]
    power = (predicted**2).sum() - (0.0 if view.spread is None else (view.spread[inside] ** 2).sum())
    factor = (predicted * true).sum() / power if power > BLACK else 1.0
    spread = None if view.spread is None else factor * view.spread
    return pictures(replace(view, predicted=factor * view.predicted, spread=spread), protocol, encoding)


def scalar(view: Pair, protocol: Protocol) -> Compared:
    """Compare roughness or metallic: as it is, or in a whole image with the background's grey around it."""
    if protocol.comparison.area == "object":
        return as_it_is(view, protocol)
    scored = _eroded(view, protocol.comparison)
    _expect_finite(view, scored, everywhere=True)
    pair = _known(_composed(view, protocol.comparison, scored, (view.predicted, view.true)), view)
    return Compared(*pair, view.known, protocol, whole=True)


def as_it_is(view: Pair, protocol: Protocol) -> Compared:
    """Compare what is neither encoded nor clipped, over the object."""
    _expect_finite(view, view.mask)
    return Compared(view.predicted, view.true, view.mask, protocol, parts=view.parts)


def _expect_finite(view: Pair, scored: np.ndarray, *, everywhere: bool = False) -> None:
    """``everywhere``: in any pixel of the picture, since no weight, not even 0, takes NaN out of a mean."""
    if not scored.any():
        raise NoScoredPixel
    finite = np.isfinite(view.predicted)
    broken = ~(finite if finite.ndim == 2 else finite.all(-1))
    if count := int((broken if everywhere else broken & view.mask).sum()):
        raise Undefined(f"the prediction is not finite in {count}{'' if everywhere else ' scored'} pixels")


def _encoded(
    view: Pair, encoding: Encoding, scale: np.ndarray | float = 1.0, gain: float = 1.0, largest: float = 1.0
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[int, int]]:
    """Prediction times ``scale``, and truth, both times ``gain``, encoded and clipped; and how many values of each were clipped."""
    parts = view.predicted * scale * gain, view.true * gain
    (predicted, of_predicted), (true, of_true) = (encode(values, encoding, view.mask, largest) for values in parts)
    return (predicted, true), (of_predicted, of_true)


def _spread(view: Pair, encoding: Encoding) -> np.ndarray | None:
    """Half the difference of both estimates as they are compared, encoded and clipped; None of what has no noise."""
    if view.spread is None:
        return None
    one, two = (encode(view.predicted + sign * view.spread, encoding, view.mask)[0] for sign in (1, -1))
    half: np.ndarray = (one - two) / 2
    return half


def encode(linear: np.ndarray, encoding: Encoding, inside: np.ndarray, largest: float = 1.0) -> tuple[np.ndarray, int]:
    """Encode (H, W, 3) linear values and clip them to [0, largest]; also the number of values ``inside`` (H, W) clipped."""
    values = linear_to_srgb(linear) if encoding == "srgb" else linear
    beyond = ((values < 0) | (values > largest)) & inside[..., None]
    return np.clip(values, 0.0, largest), int(beyond.sum())


def _whole(view: Pair, protocol: Protocol, encoding: Encoding, gain: float = 1.0, largest: float = 1.0) -> Compared:
    """Compare two pictures as whole images, both times ``gain``, and the grey object that is the floor of PSNR."""
    settings = protocol.comparison
    scored = _eroded(view, settings)
    _expect_finite(view, scored, everywhere=True)
    pair, clipped = _encoded(view, encoding, _scale(view, scored, settings), gain, largest)
    over = _known(_composed(view, settings, scored, pair), view)
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


def _known(pair: tuple[np.ndarray, np.ndarray], view: Pair) -> tuple[np.ndarray, np.ndarray]:
    """Two pictures that are the same where the truth is not known: windows of SSIM and LPIPS reach into that."""
    predicted, true = pair
    return np.where(view.known if true.ndim == 2 else view.known[..., None], predicted, true), true


def _eroded(view: Pair, settings: ComparisonSettings) -> np.ndarray:
    """The mask without what is nearer than half of ``settings.erosion`` pixels to its edge; the image's border is no edge."""
    if not settings.erosion:
        return view.mask
    from scipy.ndimage import binary_erosion  # only other papers' protocols need it

    return binary_erosion(view.mask, np.ones((settings.erosion, settings.erosion)), border_value=1)


def _scale(view: Pair, scored: np.ndarray, settings: ComparisonSettings) -> np.ndarray:
    """The factor of each channel (3,) that brings the prediction to the truth, or 1."""
    if settings.rescale == "none":
        return np.ones(3)
    predicted, true = view.predicted[scored].astype(np.float64), view.true[scored].astype(np.float64)
    power = (predicted**2).sum(0)
    return np.where(power > BLACK, (predicted * true).sum(0) / np.maximum(power, BLACK), 1.0)
