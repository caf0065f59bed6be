"""Which views of a scene are pictured: those whose maps can be compared with the truth, else those that were held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import Scene, View

FITTED = 6  # training views that stand for a scene that holds none out


def views_of_maps(scene: Scene) -> list[View]:
    """The views in which albedo and roughness are shown.

    These are the held-out ones whose albedo and roughness are both known; where there are none, those with one of them; where
    there are none of these either, all held-out ones; and of a scene without any, FITTED training views, evenly spread.
    """
    known = [[getattr(view, name) is not None for name in ("albedo", "roughness")] for view in scene.test]
    for enough in (all, any):
        found = [view for view, has in zip(scene.test, known, strict=True) if enough(has)]
        if found:
            return found
    if scene.test or not scene.train:
        return list(scene.test)
    places = np.linspace(0, len(scene.train) - 1, min(FITTED, len(scene.train))).round().astype(int)
    return [scene.train[place] for place in places]


def fitted_views(scene: Scene, names: Sequence[str]) -> list[View]:
    """The training views of these names, in their order. Raises InputError for one that is not there."""
    by_name = {view.name: view for view in scene.train}
    lacking = [name for name in names if name not in by_name]
    if lacking:
        raise InputError(f"{scene.source}: expected the training views that are pictured, found none named {', '.join(lacking)}")
    return [by_name[name] for name in names]


def every_has(views: Sequence[View], component: str) -> bool:
    """Whether every one of the views has this truth, "albedo" or "roughness"."""
    return all(getattr(view, component) is not None for view in views)
