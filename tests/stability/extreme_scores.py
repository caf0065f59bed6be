"""Scores and their alignment where images are identical, constant, tiny, empty, zero, negative or not numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from stability.case import Case, Measured, refused

from ia_bench.scores.comparison import scale
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined, psnr, ssim

GROUP = "scores"


def cases() -> Iterator[Case]:
    """All of them."""
    image = np.random.default_rng(0).random((16, 16, 3))
    constant, everywhere, nowhere = np.full((16, 16, 3), 0.3), np.ones((16, 16), bool), np.zeros((16, 16), bool)
    of = Compared.of_object
    one = nowhere.copy()
    one[3, 3] = True
    yield _equal("identical images", "PSNR", math.inf, lambda: psnr(of(image, image, everywhere)))
    yield _equal("identical images", "SSIM", 1.0, lambda: ssim(of(image, image, everywhere)))
    yield _equal("two constant images", "PSNR", 20.0, lambda: psnr(of(constant, constant + 0.1, everywhere)))
    yield _equal("identical constant images", "SSIM", 1.0, lambda: ssim(of(constant, constant, everywhere)))
    yield _equal("a mask of one pixel", "PSNR", 20.0, lambda: psnr(of(image, image + 0.1, one)))
    yield _refusal("empty mask", "PSNR", NoScoredPixel, "no scored pixel", lambda: psnr(of(image, image, nowhere)))
    yield _refusal("empty mask", "SSIM", NoScoredPixel, "no scored pixel", lambda: ssim(of(image, image, nowhere)))
    small, corner = image[:3, :3], everywhere[:3, :3]
    yield _refusal("3 x 3 pixels", "SSIM", Undefined, "smaller than the window", lambda: ssim(of(small, small, corner)))
    pixels = np.random.default_rng(1).random((64, 3))
    inputs = {
        "constant": (np.full((64, 3), 0.3), 1.0), "zero": (np.zeros((64, 3)), None), "negative": (-pixels, None),
        "NaN in": (np.where(np.arange(64)[:, None] == 5, np.nan, pixels), None), "1e-30 times the": (1e-30 * pixels, 1e30),
        "no": (pixels[:0], None),
    }  # fmt: skip
    for name, (predicted, expected) in inputs.items():
        quantity = "mean-RGB scale"
        reference = "none, with its reason" if expected is None else "closed form"
        yield Case(
            GROUP, f"{name} prediction", quantity, reference, 1e-6,
            lambda p=predicted, e=expected, t=pixels: _scale(p, t, e),
        )  # fmt: skip


def _equal(extreme: str, quantity: str, expected: float, measure: Callable[[], float]) -> Case:
    def measured() -> Measured:
        found = measure()
        error = 0.0 if found == expected else abs(found - expected)
        return Measured(error, finite=not math.isnan(found))

    return Case(GROUP, extreme, quantity, f"{expected:g}", 1e-9, measured)


def _refusal(extreme: str, quantity: str, error: type[Exception], words: str, action: Callable[[], object]) -> Case:
    return Case(GROUP, extreme, quantity, "undefined, with its reason", 0.0, lambda: refused(action, error, words))


def _scale(predicted: np.ndarray, true: np.ndarray, expected: float | None) -> Measured:
    try:
        found = scale("mean_rgb", predicted, true[: len(predicted)])
    except Undefined as reason:
        return Measured(0.0 if expected is None and str(reason) else math.inf)
    if expected is None:
        return Measured(math.inf)
    closed_form = float(true.mean() / predicted.mean())
    return Measured(abs(float(found[0]) / closed_form - 1), finite=bool(np.isfinite(found).all()))
