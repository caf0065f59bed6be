"""Masks as distances to their outlines, and the visual hull: the largest object that casts no more than these silhouettes.

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
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.special import ndtri
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.mesh import expect_near_origin
from ia_bench.scenes.scene import Camera, View

HALF = 0.5  # coverage on an outline
SOFT_SHARE = 0.2  # of the pixels along outlines, those of what is unknown among them, that antialiasing leaves soft, at least
REACH = 0.5  # pixels along an outline between the nearest of its points and that of the nearest pixel, about
BLUR = 0.7  # pixels, by which a mask of zeros and ones is blurred: the staircase of its outline becomes a slope
COARSEST = 16  # cells along the longest side of the box on the first grid, at least
LATTICE = 24  # cells from the middle to a side of the cube in which the box is looked for
BAND = 2.0  # cells of the coarser grid within which distances are computed again
MARGIN = 3  # cells of the finest grid around the object
POINTS_AT_ONCE = 2**18
GROWTHS = 4  # how often the first box may grow by half, before the masks are said to leave the object unbounded


# ---------------------------------------------------------------- masks as distances to their outlines
Silhouette = tuple[Camera, Tensor]
"""A camera, and in pixels how far each of its pixels is from the outline that it sees, (H, W) float32, positive outside."""


def outside(camera: Camera, distance: Tensor, points: Tensor) -> Tensor:
    """How far (N, 3) points lie outside of the cone of rays that a silhouette lets through, (N,) scene units; below 0 inside.

    Across the ray, at the depth of the point. A point behind the camera is not seen, so nothing is known: minus infinity.
    """
    (pixels,), depth = looked_up(camera, distance[None], points, padding_mode="border")
    focal = 0.5 * (camera.focal[0] + camera.focal[1])
    return torch.where(depth > 0, pixels * depth / focal, -torch.inf)


def looked_up(camera: Camera, picture: Tensor, points: Tensor, **how: str) -> tuple[Tensor, Tensor]:
    """What a camera's ``picture`` (C, H, W) shows at points (N, 3), (C, N), and how deep they are (N,).

    ``how``: "mode" and "padding_mode" of torch's ``grid_sample``; bilinear, and 0 outside of the picture, if not said.
    """
    column, row, depth = camera.project(points)
    place = torch.stack([2 * column / camera.width - 1, 2 * row / camera.height - 1], -1)[None, None]
    return grid_sample(picture[None], place, align_corners=False, **how)[0, :, 0], depth


def carving_mask(view: View) -> np.ndarray:
    """The view's mask (H, W), 1 where nothing is known."""
    return view.mask if view.valid is None else np.where(view.valid | (view.mask > 0), view.mask, np.float32(1))


def outline_distance(mask: np.ndarray) -> np.ndarray:
    """Distance in pixels (H, W) float32 from each pixel's centre to the line where coverage is one half; positive outside.

    Pixels that the line runs through tell where: of a straight line, coverage falls by the length of its chord per pixel. All
    others take the line through the nearest of these, and at corners, where that would be too near, the distance of its point.
    """
    values = mask.astype(np.float64)
    edge = _edge_pixels(values)
    blurred = ((mask > 0.02) & (mask < 0.98)).sum() < SOFT_SHARE * edge.sum()
    if blurred:
        values = gaussian_filter(values, BLUR)
        edge = _edge_pixels(values)
    inside = values > HALF
    side = np.where(inside, -1.0, 1.0)
    if not edge.any():  # all of the picture on one side
        return (side * np.hypot(*mask.shape)).astype(np.float32)
    slope = slopes(gaussian_filter(values, 0.5))
    normal = -slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-9)  # outward
    chord = 1 / np.maximum(np.abs(normal).max(0), 0.5)
    offset = -BLUR * ndtri(values.clip(0.01, 0.99)) if blurred else (HALF - values) / chord
    whole, nearest = distance_transform_edt(~edge, return_indices=True)
    row, column = nearest
    apart = np.indices(mask.shape) - nearest + (offset * normal)[:, row, column]
    straight = (apart * normal[:, row, column]).sum(0)
    corner = side * np.maximum(np.linalg.norm(apart, axis=0) - REACH, 0)
    distance = np.where(np.abs(corner) > side * straight, corner, straight)
    return np.where(whole == 0, offset, distance).astype(np.float32)


def slopes(picture: np.ndarray) -> np.ndarray:
    """By how much a picture (H, W) grows a pixel, downward and to the right, (2, H, W); 0 across a strip of one pixel."""
    sides = enumerate(picture.shape)
    return np.stack([np.gradient(picture, axis=axis) if side > 1 else np.zeros_like(picture) for axis, side in sides])


def grown_mask(view: View, pixels: float) -> np.ndarray:
    """The view's mask (H, W) larger by so many pixels, or smaller if they are below 0; 0 where nothing is known.

    Where it meets what nobody knows, it neither shrinks nor does anything grow from there.
    """
    distance = outline_distance(view.mask if pixels > 0 else carving_mask(view))
    grown = (HALF + pixels - distance).clip(0, 1).astype(np.float32)
    return np.where(view.known | (view.mask > 0), grown, np.float32(0))


def _edge_pixels(values: np.ndarray) -> np.ndarray:
    """The one of every two neighbours (H, W) on different sides of one half that is nearer to it; both if neither is."""
    inside, away = values > HALF, np.abs(values - HALF)
    edge = np.zeros(values.shape, bool)
    for one, two in (((slice(None, -1),), (slice(1, None),)), ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))):
        crossed = inside[one] != inside[two]
        edge[one] |= crossed & (away[one] <= away[two])
        edge[two] |= crossed & (away[two] <= away[one])
    return edge


def centre_of(views: Sequence[View]) -> np.ndarray:
    """The point (3,) that is nearest, by least squares, to the rays from the cameras through the middles of the masks.

    Views that show nothing of the object have no say. Raises InputError where no other is left.
    """
    shown = [view for view in views if (view.mask > HALF).any()]
    if not shown:
        raise InputError(f"masks: expected a view whose mask exceeds {HALF} in some pixel, found none among {len(views)}")
    origins, directions = [], []
    for view in shown:
        row, column = (places.mean() + 0.5 for places in np.nonzero(view.mask > HALF))
        direction = view.camera.rays(column, row)
        origins.append(view.camera.position)
        directions.append(direction / np.linalg.norm(direction))
    return where_they_meet(np.stack(origins), np.stack(directions))


def where_they_meet(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The point (3,) that is nearest, by least squares, to rays from ``origins`` (N, 3) along unit ``directions`` (N, 3)."""
    across = np.eye(3) - np.einsum("ni,nj->nij", directions, directions)  # takes the part along a ray away
    point: np.ndarray = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, origins), rcond=None)[0]
    return point


# ---------------------------------------------------------------- the hull
class OpenHullError(InputError):
    """The masks leave the object unbounded: there are too few views, or they look from one side."""


def visual_hull(views: Sequence[View], cells: int, tolerated: int = 0) -> DistanceGrid:
    """The hull of the masks of ``views``, on a grid of ``cells`` along the longest side, of which a few on either side are margin.

    ``tolerated``: how many views may see a point outside of their masks before it is cut away; the rest decide.

    Raises InputError where no point is inside of all masks, or the object is too far from the origin; OpenHullError where the masks
    leave it unbounded.
    """
    outlines = [(view.camera, torch.from_numpy(outline_distance(carving_mask(view)))) for view in views]
    low, high = _bounds(views, outlines, tolerated)
    expect_near_origin("masks", low.numpy(), high.numpy())
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
            distance = outside(*outline, part)
            for place in range(tolerated + 1):
                largest[place], distance = torch.maximum(largest[place], distance), torch.minimum(largest[place], distance)
        found.append(largest[-1])
    return torch.cat(found)


def _bounds(views: Sequence[View], outlines: Sequence[Silhouette], tolerated: int) -> tuple[Tensor, Tensor]:
    """The corners (3,) of a box around the hull, on a coarse grid around the point that all cameras look at."""
    centre = centre_of(views)
    half = 0.0  # how far from the centre the object reaches across any view, at its depth, scene units
    for view in views:
        column, row, depth = (float(part) for part in view.camera.project(torch.from_numpy(centre).float()[None]))
        rows, columns = np.nonzero(view.mask > HALF)
        (across, along) = view.camera.focal
        apart = np.hypot((columns + 0.5 - column) / across, (rows + 0.5 - row) / along)
        half = max(half, float(apart.max(initial=0.0)) * max(depth, 0.0))  # 0 of a view that shows nothing of the object
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
            )
        low, high = touched.amin(0) - cell, touched.amax(0) + cell
        if (low > points[0] - 0.5 * cell).all() and (high < points[-1] + 0.5 * cell).all():
            return low, high
        half *= 1.5
    doubted = f", {tolerated} of which may be wrong (capture.tolerated)" if tolerated else ""
    raise OpenHullError(
        f"masks: expected views from enough sides to bound the object, found {len(views)} views that leave it open{doubted}; "
        "hulls (capture.geometry=hull and sdf, capture.consistency) need views from all around"
    )
