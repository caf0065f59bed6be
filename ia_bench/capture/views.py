"""Fewer views, spread evenly: those of a smaller number are among those of a larger one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.geometry.silhouettes import centre_of
from ia_bench.scenes.scene import View


def spread(views: Sequence[View], count: int) -> tuple[View, ...]:
    """``count`` of the views, in their order. Raises InputError where there are fewer."""
    if count > len(views):
        raise InputError(f"capture.views={count}: expected at most {len(views)}, the training views of the scene, or all")
    return tuple(views[index] for index in sorted(farthest_first(views)[:count]))


def farthest_first(views: Sequence[View]) -> list[int]:
    """All views, the first one first; every next one is that whose direction is farthest from all before it.

    Directions are those from the point that the cameras look at, which asks for no mesh.
    """
    directions = np.stack([view.camera.to_world[:3, 3] for view in views]) - centre_of(views)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    order = [0]
    nearest = directions @ directions[0]  # cosine to the nearest direction that is taken
    while len(order) < len(views):
        nearest[order] = np.inf
        order.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, directions @ directions[order[-1]])
    return order
