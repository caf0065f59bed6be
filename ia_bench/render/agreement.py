"""Do mesh, cameras and images belong together? What cameras see of the mesh is compared with the masks of their images.

Agreement = sum min(mask, coverage) / sum max(mask, coverage) over the pixels of a few training views: the intersection over
the union where both are 0 or 1. A mesh in another place or unit, and cameras in another convention, have next to none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from ia_bench.common.errors import InputError
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.scenes.scene import CONVENTIONS, FROM_Y_UP, Scene, View

VIEWS = 8
SIDE = 64  # pixels that the larger side is reduced to in square blocks, or to more where blocks would exceed the smaller side
GOOD, LEAST = 0.9, 0.3
MISTAKES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    **{f"transform_matrix taken as {what}": mended for what, mended in CONVENTIONS.items()},
    "the mesh taken as one with +y up": lambda matrix: FROM_Y_UP.T @ matrix,
    "the cameras taken as those of a world with +y up": lambda matrix: FROM_Y_UP @ matrix,
}
"""Conventions of others: what would have to be done to a camera for it to be in ours."""

USUAL = (
    "transform_matrix has to be camera-to-world in the OpenGL convention (the camera looks along its -z axis, +y is up), "
    "in the units and at the place of the mesh, and the masks those of the whole mesh"
)


def check_agreement(
    scene: Scene,
    note: Callable[[str], None],
    mistakes: Mapping[str, Callable[[np.ndarray], np.ndarray]] = MISTAKES,
    usual: str = USUAL,
) -> float:
    """Tell how far the mesh covers the masks of the training views, and below GOOD the likely cause. Below LEAST: InputError.

    The cause is the one of ``mistakes`` without which it would cover them best, or else the ``usual`` one.
    """
    some = scene.train[:: max(1, len(scene.train) // VIEWS)][:VIEWS]
    sizes = [(view.camera.width, view.camera.height) for view in some]
    views = [view.scaled(min(-(-max(size) // SIDE), *size)) for view, size in zip(some, sizes, strict=True)]
    rays = make_rays(scene.expect_mesh(), torch.device("cpu"))  # not those of a run, which counts its rays
    found = _agreement(rays, views)
    said = f"intersection over union {found:.2f} over {len(views)} training views"
    if found >= GOOD:
        note(f"mesh and masks: {said}")
        return found
    best, cause = max(GOOD, found + 0.1), usual
    for mistake, mended in mistakes.items():
        moved = [replace(view, camera=replace(view.camera, to_world=mended(view.camera.to_world))) for view in views]
        otherwise = _agreement(rays, moved)
        if otherwise > best:
            best, cause = otherwise, f"with {mistake} it would be {otherwise:.2f}"
    message = f"{scene.source}: expected the mesh to cover the masks of the images, found {said}; {cause}"
    if found < LEAST:
        raise InputError(message)
    note(f"warning: {message}")
    return found


def _agreement(rays: RayCaster, views: Sequence[View]) -> float:
    both = either = 0.0
    for view in views:
        coverage = trace_gbuffer([view.camera], rays, 2, torch.device("cpu")).coverage()[0].numpy()
        both += float(np.minimum(view.mask, coverage)[view.known].sum())
        either += float(np.maximum(view.mask, coverage)[view.known].sum())
    return both / either if either else 0.0
