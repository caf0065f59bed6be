"""Fewer views, spread evenly: those of a smaller number are among those of a larger one."""

from __future__ import annotations

from collections.abc import Sequence

from ia_bench.common.errors import InputError
from ia_bench.geometry.silhouettes import centre_of
from ia_bench.scenes.scene import View, farthest_first


def spread(views: Sequence[View], count: int) -> tuple[View, ...]:
    """``count`` of the views, in their order. Raises InputError where there are fewer.

    Directions are those from the point that the cameras look at, which asks for no mesh.
    """
    if count > len(views):
        raise InputError(f"capture.views={count}: expected at most {len(views)}, the training views of the scene, or all")
    return tuple(views[index] for index in sorted(farthest_first(views, centre_of(views))[:count]))
