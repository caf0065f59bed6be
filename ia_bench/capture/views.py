"""Fewer views, spread evenly, and fewer pixels of them: those that lie well inside of a mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.geometry.hull import carving_mask, centre_of, outline_distance
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import View, farthest_first


def spread(views: Sequence[View], count: int) -> tuple[View, ...]:
    """``count`` of the views, in their order. Raises InputError where there are fewer.

    Directions are those from the point that the cameras look at, which asks for no mesh.
    """
    if count > len(views):
        raise InputError(f"capture.views={count}: expected at most {len(views)}, the training views of the scene, or all")
    return tuple(views[index] for index in sorted(farthest_first(views, centre_of(views))[:count]))


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
