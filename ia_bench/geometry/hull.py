"""The visual hull: the largest object that casts no more than the given silhouettes.

A point is in it if every view sees it inside of its mask (Laurentini 1994). How far a point is outside of the hull is no less
than how far it is outside of each silhouette's cone, so the largest of these distances is a field that is exact at the
hull's faces, and whose zero is found to a fraction of a cell. It is computed on a coarse grid first, then near the surface
alone. Hulls have no hollows: whatever no view sees as background in front of stays filled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.silhouettes import HALF, Silhouette, centre_of, silhouettes
from ia_bench.scenes.scene import View

COARSEST = 16  # cells along the longest side of the box on the first grid, at least
LATTICE = 24  # cells from the middle to a side of the cube in which the box is looked for
BAND = 2.0  # cells of the coarser grid within which distances are computed again
MARGIN = 3  # cells of the finest grid around the object
POINTS_AT_ONCE = 2**18
GROWTHS = 4  # how often the first box may grow by half, before the masks are said to leave the object unbounded


class OpenHullError(InputError):
    """The masks leave the object unbounded: there are too few views, or they look from one side."""


def visual_hull(views: Sequence[View], cells: int, tolerated: int = 0) -> DistanceGrid:
    """The hull of the masks of ``views``, on ``cells`` cells along the longest side of its bounding box.

    ``tolerated``: how many views may see a point outside of their masks before it is cut away; the rest decide.

    Raises InputError where no point is inside of all masks, and OpenHullError where the masks leave the object unbounded.
    """
    outlines = silhouettes(views)
    low, high = _bounds(views, outlines, tolerated)
    step = float((high - low).max()) / (cells - 2 * MARGIN)
    halvings = max(0, int(math.log2(cells / COARSEST)))
    whole = 2**halvings  # cells of the coarsest grid count as so many
    counts = [whole * math.ceil((float(extent) / step + 2 * MARGIN) / whole) for extent in high - low]
    box = step * torch.tensor(counts, dtype=torch.float32)
    coarsest = [count // whole + 1 for count in counts]
    grid = DistanceGrid(torch.zeros(coarsest), 0.5 * (low + high) - 0.5 * box, step * whole)
    near = torch.ones(coarsest, dtype=torch.bool)
    for level in range(halvings + 1):
        if level:
            band = BAND * grid.step
            grid = grid.refined()
            near = grid.values.abs() < band
        grid.values[near] = outside_of_all(outlines, grid.low + grid.step * torch.nonzero(near), tolerated)
    return grid


def outside_of_all(outlines: Sequence[Silhouette], points: Tensor, tolerated: int = 0) -> Tensor:
    """The largest distance (N,) of (N, 3) points outside of the cones of the silhouettes, scene units.

    Or the largest but the first few, where as many views as that are ``tolerated`` to be wrong.
    """
    found = []
    for part in points.split(POINTS_AT_ONCE):
        largest = torch.full((tolerated + 1, len(part)), -torch.inf)  # in falling order
        for outline in outlines:
            distance = outline.outside(part)
            for place in range(tolerated + 1):
                largest[place], distance = torch.maximum(largest[place], distance), torch.minimum(largest[place], distance)
        found.append(largest[-1])
    return torch.cat(found)


def _bounds(views: Sequence[View], outlines: Sequence[Silhouette], tolerated: int) -> tuple[Tensor, Tensor]:
    """The corners (3,) of a box around the hull, on a coarse grid around the point that all cameras look at."""
    centre = centre_of(views)
    half = max(_reach(view, centre) for view in views)
    for _ in range(GROWTHS):
        lattice = torch.linspace(-1, 1, 2 * LATTICE + 1)
        offsets = half * torch.stack(torch.meshgrid(lattice, lattice, lattice, indexing="ij"), -1).reshape(-1, 3)
        points = torch.from_numpy(centre).float() + offsets
        cell = half / LATTICE
        touched = points[outside_of_all(outlines, points, tolerated) < cell]
        if len(touched) == 0:
            raise InputError(
                "masks: expected them to show one object from all sides, found no point that is inside of all of them; "
                "cameras in another convention are the usual cause, or one wrong mask, which capture.tolerated=1 survives"
                + _perhaps_inverted(views)
            )
        low, high = touched.amin(0) - cell, touched.amax(0) + cell
        if (low > points[0] - 0.5 * cell).all() and (high < points[-1] + 0.5 * cell).all():
            return low, high
        half *= 1.5
    doubted = f", {tolerated} of which may be wrong (capture.tolerated)" if tolerated else ""
    raise OpenHullError(
        f"masks: expected views from enough sides to bound the object, found {len(views)} views that leave it open{doubted}; "
        "hulls (capture.geometry=hull and sdf, capture.consistency) need views from all around" + _perhaps_inverted(views)
    )


def _perhaps_inverted(views: Sequence[View]) -> str:
    """A question, where most pixels along the borders of the pictures belong to the object: beyond objects there is background."""
    sides = [side for view in views for side in (view.mask[0], view.mask[-1], view.mask[:, 0], view.mask[:, -1])]
    share = float((np.concatenate(sides) > HALF).mean())
    return f"; masks are white along {share:.0%} of the pictures' borders: is white the object in them?" if share > 0.5 else ""


def _reach(view: View, centre: np.ndarray) -> float:
    """How far from ``centre`` the object reaches across the view, at its depth, scene units."""
    camera = view.camera
    column, row, depth = (float(part) for part in camera.project(torch.from_numpy(centre).float()[None]))
    rows, columns = np.nonzero(view.mask > HALF)
    farthest = np.hypot((columns + 0.5 - column) / camera.focal[0], (rows + 0.5 - row) / camera.focal[1]).max()
    return float(farthest) * max(depth, 0.0)
