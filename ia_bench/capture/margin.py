"""What of a photograph is the object's for certain: pixels well inside of its mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ia_bench.geometry.silhouettes import carving_mask, outline_distance
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import View


def inside(views: Sequence[View], margin: float) -> tuple[View, ...]:
    """The views without all that is less than ``margin`` pixels inside of their masks, or outside: nobody knows what is there.

    A pixel on a wrong side of an outline shows the background, or is black where the object is; so wide an edge is left out that
    none such is left in. A point of the surface that one view sees there, others see away from their outlines.
    """
    return tuple(_inside(view, margin) for view in views)


def _inside(view: View, margin: float) -> View:
    sure = (outline_distance(carving_mask(view)) < -margin) & (view.mask > 0)
    if not sure.any():  # a view of next to nothing: better unsure than unseen
        return view
    image = np.where(sure[..., None], straight(view.image, view.mask), np.float32(0))
    return replace(view, image=image, mask=sure.astype(np.float32), valid=sure & view.known)
