"""What a capture of one's own has less of, views and pixels, and what goes wrong: cameras a little off, wrong masks, blur.

Every draw belongs to one photograph, by its name, and to one kind of fault: so the faults of a photograph are the same
whichever others are taken, and one kind can be set without a change of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from ia_bench.capture.settings import FaultSettings
from ia_bench.common.errors import InputError
from ia_bench.common.seeds import derive_seed
from ia_bench.geometry.consistency import moved, pixel_motions, seen_at
from ia_bench.geometry.hull import HALF, carving_mask, centre_of, grown_mask, outline_distance
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Camera, View, farthest_first

POSE, GROWTH, WRONG, SIDE, BLURRED = range(5)  # purposes of draws
SMALL = 1e-3  # pixels by which a motion moves a camera's image, when its effect is measured


# ---------------------------------------------------------------- poses
def misplaced(views: Sequence[View], faults: FaultSettings) -> list[Camera]:
    """The cameras of the views, each moved at random so that points of the object move by ``faults.poses`` pixels in its image.

    That is the expected root mean square over the surface of a ball in place of the object. A motion turns the camera about its
    three axes and shifts it along them; each of the six alone would move the ball's image about as much as any other.
    """
    if faults.poses == 0:
        return [view.camera for view in views]
    centre, found = centre_of(views), []
    for view in views:
        camera, area = view.camera, max(float((view.mask > HALF).sum()), 1.0)
        focal = 0.5 * (camera.focal[0] + camera.focal[1])
        distance = float(np.linalg.norm(camera.position - centre))
        points = centre + np.sqrt(area / np.pi) / focal * distance * np.concatenate([np.eye(3), -np.eye(3)])
        units = pixel_motions(camera, distance, area)
        apart = [seen_at(moved(camera, SMALL * units * one), points) - seen_at(camera, points) for one in np.eye(6)]
        expected = float(np.sqrt(np.sum(np.square(apart)) / len(points))) / SMALL
        found.append(moved(camera, faults.poses / expected * units * _random(faults, POSE, view).standard_normal(6)))
    return found


# ---------------------------------------------------------------- masks
def mistaken_masks(views: Sequence[View], faults: FaultSettings) -> list[np.ndarray]:
    """The masks (H, W) that the object is cut out by: grown, and for some views without one half of the object.

    Where nobody knows whether the object is seen, that stays so. Raises InputError where nothing is left of a mask.
    """
    chosen = _chosen(views, faults, "wrong_masks", WRONG)
    masks = []
    for place, view in enumerate(views):
        mask, pixels = view.mask, faults.mask_growth + faults.mask_jitter * _random(faults, GROWTH, view).uniform(-1, 1)
        if pixels:
            mask = grown_mask(view, pixels)
        if place in chosen:  # it loses what is on one side of a line through its middle
            angle = _random(faults, SIDE, view).uniform(0, 2 * np.pi)
            rows, columns = np.nonzero(view.mask > HALF)
            row, column = np.ogrid[: mask.shape[0], : mask.shape[1]]
            kept = np.cos(angle) * (column - columns.mean()) + np.sin(angle) * (row - rows.mean()) > 0
            mask = mask * kept.astype(np.float32)
        if not (mask > HALF).any():
            raise InputError(f"capture.faults: view {view.name}: expected to leave a part of its mask, found all of it taken away")
        masks.append(mask)
    return masks


# ---------------------------------------------------------------- focus
def blurred(views: Sequence[View], faults: FaultSettings) -> list[View]:
    """The views, some of them through a Gaussian of ``faults.blur`` pixels: picture and coverage."""
    chosen = _chosen(views, faults, "blurred_views", BLURRED)

    def through(view: View) -> View:
        image, mask = (gaussian_filter(part, faults.blur, axes=(0, 1)) for part in (view.image, view.mask))
        return replace(view, image=image, mask=mask)

    return [through(view) if place in chosen else view for place, view in enumerate(views)]


# ---------------------------------------------------------------- draws
def _random(faults: FaultSettings, purpose: int, view: View) -> np.random.Generator:
    return np.random.default_rng(derive_seed(faults.seed, purpose, view.name))


def _chosen(views: Sequence[View], faults: FaultSettings, setting: str, purpose: int) -> set[int]:
    """Places of as many views as ``setting`` says: those with the lowest draws."""
    count = getattr(faults, setting)
    if count > len(views):
        raise InputError(f"capture.faults.{setting}={count}: expected at most {len(views)}, the views that are taken")
    draws = [_random(faults, purpose, view).random() for view in views]
    return set(np.argsort(draws)[:count].tolist())


# ---------------------------------------------------------------- fewer views, and fewer pixels of them
def spread_over_directions(views: Sequence[View], count: int) -> tuple[View, ...]:
    """``count`` of the views, in their order. Raises InputError where there are fewer.

    Directions are those from the point that the cameras look at, which asks for no mesh.
    """
    if count > len(views):
        raise InputError(f"capture.views={count}: expected at most {len(views)}, the training views of the scene, or all")
    return tuple(views[index] for index in sorted(farthest_first(views, centre_of(views))[:count]))


def inside(views: Sequence[View], margin: float, note: Callable[[str], None]) -> tuple[View, ...]:
    """The views without all that is less than ``margin`` pixels inside of their masks, or outside: nobody knows what is there.

    A pixel on a wrong side of an outline shows the background, or is black where the object is; so wide an edge is left out that
    none such is left in. A point of the surface that one view sees there, others see away from their outlines. Views of which
    nothing would be left stay whole, of which ``note`` is told.
    """
    found, whole = [], list[str]()
    for view in views:
        sure = (outline_distance(carving_mask(view)) < -margin) & (view.mask > 0)
        if not sure.any():  # of a view of next to nothing better unsure than unseen
            whole.append(view.name)
        else:
            shown = {name: values for name in ("image", "albedo", "specular") if (values := getattr(view, name)) is not None}
            cut: dict[str, Any] = {name: np.where(sure[..., None], straight(of, view.mask), 0.0) for name, of in shown.items()}
            view = replace(view, **cut, mask=sure.astype(np.float32), valid=sure & view.known)
        found.append(view)
    if whole:
        some = ", ".join(whole[:3]) + ", ..." * (len(whole) > 3)
        note(f"capture.margin={margin:g}: {len(whole)} of {len(views)} views stay whole, of which it would leave nothing: {some}")
    return tuple(found)
