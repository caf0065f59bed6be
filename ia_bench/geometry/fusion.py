"""From depth maps to one field of signed distances: a truncated mean of what all views say (Curless and Levoy 1996)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.sweep import DepthMap

TRUNCATION = 3.0  # cells from its depth within which a view tells how far a point is; before that "outside", behind nothing
LEAST_TRUST = 0.3  # correlation from which a depth counts
PASSING = 0.5  # weight of a view that only says "outside": a depth that is too large would say so of the object
ENOUGH = 0.2  # weight of all views together at which they count as much as the hull, which is what is believed without any
FAR = 8.0  # cells, beyond which nobody asks how far the surface is
BLUR = 0.5  # cells, of distances that come from triangles


def fused(hull: DistanceGrid, maps: Sequence[DepthMap]) -> DistanceGrid:
    """The part of the hull that depth maps leave, as signed distances on the grid of the hull.

    Of a point, view v says d_v = depth of its map - depth of the point, cut to the truncation, with the weight
    (trust - least trust)^2; the mean of these and of the hull is kept, where that is farther outside than the hull.
    """
    inside = torch.nonzero(hull.values.reshape(-1) < hull.step)[:, 0]
    points = hull.positions().reshape(-1, 3)[inside]
    reach = TRUNCATION * hull.step
    total, weights = torch.zeros(len(points)), torch.full((len(points),), ENOUGH)
    total += ENOUGH * hull.values.reshape(-1)[inside].clamp(-reach, reach)
    for one in maps:
        column, row, depth = one.camera.project(points)
        place = torch.stack([2 * column / one.camera.width - 1, 2 * row / one.camera.height - 1], -1)[None, None]
        layers = torch.stack([one.depth, one.trust])[None]
        there, trust = grid_sample(layers, place, mode="nearest", align_corners=False)[0, :, 0]
        outside = there - depth
        weight = (trust - LEAST_TRUST).clamp_min(0) ** 2 * ((there > 0) & (depth > 0) & (outside > -reach))
        weight = torch.where(outside > reach, PASSING * weight, weight)
        total += weight * outside.clamp(-reach, reach)
        weights += weight
    values = hull.values.clone().reshape(-1)
    values[inside] = torch.maximum(values[inside], total / weights)
    if not values.min() < 0:  # the views agree about nothing
        return hull
    return redistanced(DistanceGrid(values.reshape(hull.values.shape), hull.low, hull.step))


def redistanced(grid: DistanceGrid) -> DistanceGrid:
    """Distances, of FAR cells at most, to the zero of a field whose values are none: to the nearest points of its triangles."""
    values = grid.values.numpy()
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    surface = np.concatenate([vertices, vertices[faces].mean(1)])
    places = np.indices(values.shape).reshape(3, -1).T
    distance = cKDTree(surface).query(places, distance_upper_bound=FAR)[0].clip(max=FAR).reshape(values.shape)
    signed: np.ndarray = gaussian_filter(np.where(values < 0, -distance, distance), BLUR)
    found: Tensor = torch.from_numpy(signed.astype(np.float32)) * grid.step
    return DistanceGrid(found, grid.low, grid.step)
