"""Linear images premultiplied by their coverage: what covers a pixel, what a display shows of it, and pictures of several views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ia_bench.scenes.color import Array, linear_to_srgb, where

ROUNDING = 1e-3  # a coverage summed in float32 or stored in half precision may exceed 1 by this much


def straight(image: Array, coverage: Array, least: float = 0.0) -> Array:
    """What covers each pixel of ``image`` (..., H, W[, C]), premultiplied by ``coverage`` (..., H, W): the quotient of both.

    It is black where nothing is covered, whatever the image holds there. A coverage below ``least`` counts as that.
    """
    share = coverage if image.ndim == coverage.ndim else coverage[..., None]
    covered = share > 0
    quotient: Array = where(covered, image / where(covered, share.clip(least), 1.0), 0.0)
    return quotient


def display(image: Array, coverage: Array, exposure: float = 1.0) -> Array:
    """What covers each pixel, times ``exposure``, as a display shows it: sRGB in [0, 1], clipped."""
    return linear_to_srgb((exposure * straight(image, coverage)).clip(0, 1))


@dataclass(frozen=True)
class Images:
    """One linear image per view, premultiplied by its coverage. Views may differ in size.

    Attributes:
        images: (H, W, 3), or (H, W) where there is one channel.
        coverage: (H, W) in [0, 1], the share of each pixel that shows the object.
        known: (H, W) bool, False where the image is no more than a lower bound; None where every pixel of a view, or of all
            of them, is known.
        spread: Half the difference of two independent estimates, of which each image is the mean; None of what has no noise.

    Raises:
        ValueError: Counts or shapes of images and coverage disagree, or a coverage leaves [0, 1].
    """

    images: tuple[np.ndarray, ...]
    coverage: tuple[np.ndarray, ...]
    known: tuple[np.ndarray | None, ...] | None = None
    spread: tuple[np.ndarray, ...] | None = None

    def __post_init__(self) -> None:
        """Check counts, shapes and the range of coverage."""
        if len(self.images) != len(self.coverage):
            raise ValueError(f"expected a coverage per image, found {len(self.coverage)} for {len(self.images)} images")
        for index, (image, coverage) in enumerate(zip(self.images, self.coverage, strict=True)):
            if coverage.ndim != 2 or image.shape not in (coverage.shape, (*coverage.shape, 3)):
                raise ValueError(
                    f"view {index}: expected an image (H, W, 3) or (H, W) with coverage (H, W), "
                    f"found {image.shape} with {coverage.shape}"
                )
            if not ((coverage >= 0) & (coverage <= 1 + ROUNDING)).all():
                found = f"{coverage.min()} to {coverage.max()}"
                raise ValueError(f"view {index}: expected coverage in [0, 1], found {found}")

    def exposed(self, factors: Sequence[float | None]) -> Images:
        """The images, each times its factor; None leaves one as it is."""

        def times(images: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
            pairs = zip(images, factors, strict=True)
            return tuple(image if factor is None else image * np.float32(factor) for image, factor in pairs)

        return replace(self, images=times(self.images), spread=None if self.spread is None else times(self.spread))

    def averaged(self, other: Images) -> Images:
        """The mean of two estimates of the same views, with their ``spread``; as they are where they are equal."""
        pairs = list(zip(self.images, other.images, strict=True))
        if all(np.array_equal(one, two, equal_nan=True) for one, two in pairs):
            return self
        means = tuple((one + two) / 2 for one, two in pairs)
        return replace(self, images=means, spread=tuple((one - two) / 2 for one, two in pairs))

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.images)
