"""Which photographs of a capture stand out: one that is blurred, one whose mask or pose disagrees with all others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter

from ia_bench.checks.finding import Finding, judge
from ia_bench.common.errors import InputError
from ia_bench.geometry.consistency import nearest_to_rays, outline
from ia_bench.geometry.hull import outline_distance, visual_hull
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import View

CELLS = 64  # of the hulls that masks are compared with
MANY = 24  # views of which two may be wrong about a point of the hull; of fewer, one
FEWEST = 6  # views of which one can stand out
FARTHER, PIXELS = 4.0, 0.75  # a mask stands out if it is so many times as far as the median, and so many pixels farther
INSIDE = 0.03  # of the object's extent, which it has to be if it lies inside: where one view alone sees a hollow, it does, too
FINE, COARSE = 0.7, 3.0  # pixels: detail that blur takes, and what there is of detail at all
TYPICAL, PIXEL = 0.01, 1.0  # of the object's extent, and pixels: a larger median is a fault of all views, and not of one
SOFTER = 0.4  # a view stands out if it has less than this share of the median's fine detail
DEEP = 2.0  # pixels inside of the mask from where on the picture is looked at


def check_views(views: Sequence[View], *, meshless: bool = True) -> Iterator[Finding]:
    """How far all masks are from one object, the view whose mask is farthest from it, and the least sharp one.

    A cross where a view stands out, or all are far. ``meshless``: no mesh tells whether the focal length is right.
    """
    if len(views) < FEWEST:
        yield Finding("skip", "worst view", "", f"{len(views)} views are too few for one to stand out")
        return
    try:
        apart = disagreement(views)
    except InputError as error:
        yield Finding("fail", "masks", "masks and poses that leave one object", str(error))
    else:
        typical = float(np.median(np.abs(apart)))
        limit = max(FARTHER * typical, typical + PIXELS)
        beyond = np.abs(apart) - np.where(apart < 0, max(limit, INSIDE * _extent(views)), limit)
        worst = int(beyond.argmax())
        found = (
            f"view {views[worst].name}: its outline lies {abs(apart[worst]):.1f} pixels "
            f"{'outside' if apart[worst] > 0 else 'inside'} of what the others' masks leave; {typical:.1f} is the median"
        )
        yield _together(views, typical, meshless)
        yield judge(bool(beyond[worst] <= 0), "worst mask or pose", "no view that stands out", found)
    fine = np.array([sharpness(view) for view in views])
    if not np.isfinite(fine).any():
        yield Finding("skip", "least sharp view", "", "the object is too small or too even to tell")
        return
    typical, worst = float(np.nanmedian(fine)), int(np.nanargmin(fine))
    found = f"view {views[worst].name}: {fine[worst] / max(typical, 1e-12):.0%} of the fine detail of the median"
    yield judge(fine[worst] >= SOFTER * typical, "least sharp view", "none that is much softer than the others", found)


def _together(views: Sequence[View], typical: float, meshless: bool) -> Finding:
    """Whether all views together leave one object: what is wrong with all alike, such as a focal length, makes none stand out.

    A focal length twice too long moves outlines by 1 to 2 % of the object's extent, in the median over views: 1.7 and 1.2 pixels
    on hat and figurine (128 x 128 pixels), .2 on tiny (32 x 32), where nobody can tell.
    """
    what, extent = "all masks and poses", _extent(views)
    limit = max(PIXEL, TYPICAL * extent)
    if typical > limit:
        found = f"{typical:.1f}: the focal length, poses or masks are wrong (capture.consistency=3 makes the last two agree)"
        return Finding("fail", what, f"outlines within {limit:.1f} pixels of what all leave, in the median", found)
    if meshless and TYPICAL * extent < 0.5 * PIXEL:
        found = f"the object is {extent:.0f} pixels wide, too few to tell a wrong focal length"
        return Finding("skip", "focal length", "", found)
    found = f"outlines lie {typical:.1f} pixels from what all leave, in the median; up to {limit:.1f} is usual"
    return Finding("pass", what, "", found)


def _extent(views: Sequence[View]) -> float:
    """How many pixels the object is wide, about."""
    return float(np.median([np.sqrt((view.mask > 0.5).sum()) for view in views]))


def disagreement(views: Sequence[View]) -> np.ndarray:
    """How far the outline of each view lies outside of a hull of all masks that no single one decides, (V,) pixels; below 0 inside.

    In the mean of absolute distances, with the sign of most. Where a mask lacks a part of the object its outline runs inside of
    that hull, and where it has too much outside. Where a mask has no outline, the edge of what it fills counts, as far as it lies
    outside of the hull. Raises InputError where there is no hull.
    """
    grid = visual_hull(views, CELLS, 1 if len(views) < MANY else 2)
    outlines = [outline(view, grid).apart for view in views]
    common = np.median(np.concatenate(outlines))  # such a hull is larger than the object
    found = []
    for view, apart in zip(views, outlines, strict=True):
        if not len(apart):
            inside = view.mask > 0.5
            rows, columns = np.nonzero(inside & ~binary_erosion(inside))
            apart = nearest_to_rays(view.camera, rows, columns, grid)[1].clip(min=common)
        side = -1 if len(apart) and np.median(apart) < common else 1
        found.append(side * float(np.abs(apart - common).mean()) if len(apart) else 0.0)
    return np.array(found)


def sharpness(view: View) -> float:
    """The share of a picture's detail of some pixels that is detail of less than one, on the object; NaN where there is none.

    The variance of what a Gaussian of FINE pixels takes away over that of one of COARSE pixels, of display-encoded grey: a blur
    takes the first and leaves much of the second, whatever is painted on the object (after Crete et al. 2007).
    """
    inside = outline_distance(view.mask) < -DEEP
    if view.valid is not None:
        inside &= view.valid
    light = straight(view.image, view.mask).mean(-1)
    bright = float(np.quantile(light[inside], 0.95)) if inside.any() else 0.0
    if bright <= 0:
        return float("nan")
    grey = linear_to_srgb((light / bright).clip(0, 1.5))
    detail = [grey - _blurred(grey, view.mask, pixels) for pixels in (FINE, COARSE)]
    fine, all_of_it = (float(np.square(part[inside]).mean()) for part in detail)
    return fine / all_of_it if all_of_it > 1e-8 else float("nan")


def _blurred(grey: np.ndarray, mask: np.ndarray, pixels: float) -> np.ndarray:
    """The picture through a Gaussian that sees the object alone."""
    smooth: np.ndarray = gaussian_filter(grey * mask, pixels) / np.maximum(gaussian_filter(mask, pixels), 1e-6)
    return smooth
