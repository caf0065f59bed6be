"""Images as an ordinary camera keeps them: exposed, clipped, eight bits of sRGB; and read back as users' photographs are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.scene import View

COVERED = 0.5  # of a pixel that counts for the exposure
WHITE = 255


def photographed(views: Sequence[View], percentile: float, *, per_image: bool) -> tuple[View, ...]:
    """The views through eight bits, in the units of the scene.

    One exposure, or one ``per_image``, lets ``percentile`` percent of the object's pixels stay below the clip. A pixel of which a
    channel reads 255 is not ``valid``. One exposure is known, as from a camera's record, and divided out. Exposures of single
    images are not: of these only the geometric mean is divided out, and each image keeps its own factor, which is unknown.
    """
    brightest = [_brightest(view) for view in views]
    if per_image:
        exposures = [_exposure(values, percentile, view.name) for values, view in zip(brightest, views, strict=True)]
    else:
        exposures = [_exposure(np.concatenate(brightest), percentile, "all training views")] * len(views)
    unit = float(np.exp(np.mean(np.log(exposures))))
    return tuple(_quantised(view, exposure, unit) for view, exposure in zip(views, exposures, strict=True))


def eight_bits(straight: np.ndarray) -> np.ndarray:
    """Radiance as the codes 0 to 255 of its sRGB, clipped at 1."""
    return np.round(WHITE * linear_to_srgb(straight.clip(0, 1)))


def _quantised(view: View, exposure: float, unit: float) -> View:
    codes = eight_bits(exposure * _straight(view))
    clipped = (codes == WHITE).any(-1) & (view.mask > 0)
    known = ~clipped if view.valid is None else view.valid & ~clipped
    linear = srgb_to_linear(codes / WHITE) / unit * view.mask[..., None]
    return replace(view, image=linear.astype(np.float32), valid=known)


def _straight(view: View) -> np.ndarray:
    share = view.mask[..., None]
    return np.divide(view.image, share, out=np.zeros(view.image.shape), where=share > 0)


def _brightest(view: View) -> np.ndarray:
    """The brightest channel (N,) of the pixels that show the object."""
    brightest: np.ndarray = _straight(view).max(-1)[view.mask > COVERED]
    return brightest


def _exposure(values: np.ndarray, percentile: float, what: str) -> float:
    level = float(np.percentile(values, percentile)) if len(values) else 0.0
    if level <= 0:
        raise InputError(f"capture.radiometry=ldr: expected light in {what}, found {percentile:g} % of the object's pixels black")
    return 1 / level
