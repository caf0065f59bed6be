"""Depth maps by plane sweeping, and one field of them all: which depth makes a photograph agree with its neighbours?

For planes across the axis of a camera, neighbouring photographs are projected onto the plane and seen from that camera. Where the
plane meets the surface they look alike, which is measured in small windows by zero-mean normalised cross-correlation (Collins
1996; Pons et al. 2007), whatever the exposure and, nearly, the shading. Depths are chosen for all pixels together by semi-global
matching (Hirschmueller 2008). Only depths inside the visual hull are asked, since the object is nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes
from torch import Tensor

from ia_bench.common.progress import Begin, unseen
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.hull import centre_of, looked_up
from ia_bench.scenes.scene import Camera, View

NEIGHBOURS = 6  # photographs that each is compared with ...
ANGLES = 8.0, 40.0  # ... seen from the object between so many degrees away: less tells little of depth, more looks different
AGREEING = 3  # of these that have to agree: in the others, something else may be in the way
WINDOW = 5  # pixels along a side
SPACING = 2.0  # cells between planes
PLANES_AT_ONCE = 8  # more leave the processor's cache
POWER = 0.4  # of radiance: a factor of the exposure remains one, which correlation does not see, and highlights weigh less
SMALL_JUMP, LARGE_JUMP = 0.05, 0.3  # what semi-global matching pays for neighbours that are one plane, or more, apart
OUTSIDE = 1.2  # cost of a depth outside of the hull; 0 is perfect agreement, 1 none
NEVER = 9.0  # and once costs are summed
WHOLE = 0.9  # coverage from which a pixel shows nothing but the object
TEXTURE = 1e-4  # of the variance of the photograph: windows with less of it agree with nothing

TRUNCATION = 3.0  # cells from its depth within which a view tells how far a point is; before that "outside", behind nothing
LEAST_TRUST = 0.3  # correlation from which a depth counts
PASSING = 0.5  # weight of a view that only says "outside": a depth that is too large would say so of the object
ENOUGH = 0.2  # weight of all views together at which they count as much as the hull, which is what is believed without any
FAR = 8.0  # cells, beyond which nobody asks how far the surface is
BLUR = 0.5  # cells, of distances that come from triangles


@dataclass(frozen=True)
class DepthMap:
    """What the stereo of one view found: ``depth`` (H, W) along the camera's axis and ``trust`` (H, W), the correlation there.

    Both are 0 where nothing is known.
    """

    camera: Camera
    depth: Tensor
    trust: Tensor


def depth_maps(views: Sequence[View], hull: DistanceGrid, begin: Begin = unseen) -> list[DepthMap]:
    """The depth map of every view that has neighbours enough; an empty list where none has. ``begin`` shows how far it is."""
    pictures = [torch.from_numpy(view.image.clip(0) ** POWER).permute(2, 0, 1).float() for view in views]
    found = []
    task = begin("depth maps", len(views))
    for number, near in enumerate(neighbours(views)):
        if near:
            others = [(views[other].camera, pictures[other]) for other in near]
            found.append(_depth_map(views[number], pictures[number], others, hull))
        task.advance()
    return found


def neighbours(views: Sequence[View]) -> list[list[int]]:
    """For each view the numbers of those that it is compared with, nearest first; none where there are too few."""
    directions = np.stack([view.camera.position for view in views]) - centre_of(views)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    apart = np.degrees(np.arccos((directions @ directions.T).clip(-1, 1)))
    chosen = []
    for row in apart:
        near = [int(other) for other in np.argsort(row, kind="stable") if ANGLES[0] < row[other] < ANGLES[1]]
        chosen.append(near[:NEIGHBOURS] if len(near) >= AGREEING else [])
    return chosen


def _depth_map(view: View, picture: Tensor, others: Sequence[tuple[Camera, Tensor]], hull: DistanceGrid) -> DepthMap:
    empty = DepthMap(view.camera, *torch.zeros(2, *view.mask.shape))
    if not view.mask.any():
        return empty
    rows, columns = (slice(place.min(), place.max() + 1) for place in np.nonzero(view.mask > 0))
    # ---------------------------------------------------------------- planes, and where they are inside of the hull
    along = torch.from_numpy(view.camera.rays(*np.indices(view.mask.shape)[::-1] + 0.5)).float()[rows, columns]
    origin = torch.from_numpy(np.array(view.camera.position, np.float32))
    box = (torch.tensor(ends) for ends in zip(hull.low.tolist(), hull.high.tolist(), strict=True))
    corners = view.camera.project(torch.stack(torch.meshgrid(*box, indexing="ij"), -1).reshape(-1, 3))[2]
    nearest, farthest = max(float(corners.min()), SPACING * hull.step), float(corners.max())
    if farthest <= nearest:  # the camera looks away: its pose is one of those that may be wrong
        return empty
    depths = torch.arange(nearest, farthest, SPACING * hull.step)

    def planes(depths: Tensor) -> Iterator[Tensor]:
        """Points (K, H, W, 3) of a few planes at a time: those of all would take more memory than all else."""
        return (origin + some[:, None, None, None] * along for some in depths.split(PLANES_AT_ONCE))

    inside = torch.cat([_inside(hull, points) for points in planes(depths)])
    used = torch.nonzero(inside.flatten(1).any(1))[:, 0]
    if len(used) < 3:
        return empty
    part = slice(int(used[0]), int(used[-1]) + 1)
    depths, inside = depths[part], inside[part]
    # ---------------------------------------------------------------- agreement, and the depths that have most of it
    own = picture[:, rows, columns]
    parts = []
    for points in planes(depths):
        seen = (looked_up(*other, points.reshape(-1, 3))[0].reshape(-1, *points.shape[:3]).movedim(0, 1) for other in others)
        of_others = torch.stack([correlation(own, one) for one in seen])
        parts.append(of_others.topk(AGREEING, 0).values.mean(0))  # of those that agree most
    alike = torch.cat(parts)
    cost = semi_global(torch.where(inside, 1 - alike, OUTSIDE), SMALL_JUMP, LARGE_JUMP)
    cost = torch.where(inside, cost, NEVER)
    best = cost.argmin(0)
    depth = depths[0] + (best + _between(cost, best)) * (depths[1] - depths[0])
    # ---------------------------------------------------------------- pixels that know
    known = (view.mask > WHOLE) & view.known
    sure = inside.any(0) & torch.from_numpy(known[rows, columns])
    empty.depth[rows, columns] = torch.where(sure, depth, 0)
    empty.trust[rows, columns] = torch.where(sure, alike.gather(0, best[None])[0].clamp_min(0), 0)
    return empty


def _inside(hull: DistanceGrid, points: Tensor) -> Tensor:
    """Which points (..., 3) lie in the box of the hull and less than a cell outside of it, (...)."""
    boxed = ((points >= hull.low) & (points <= hull.high)).all(-1)
    return boxed & (hull.at(points.reshape(-1, 3)).reshape(boxed.shape) < hull.step)


def correlation(one: Tensor, other: Tensor) -> Tensor:
    """Zero-mean normalised cross-correlation (K, H, W) of a picture (C, H, W) with K others (K, C, H, W), around each pixel.

    Channels count together: sum of their covariances over the root of the product of the sums of their variances.
    """
    mean_one, mean_other = windowed(one[None]), windowed(other)
    spread_one = (windowed((one[None] ** 2).sum(1)) - (mean_one**2).sum(1)).clamp_min(0)
    spread_other = (windowed((other**2).sum(1)) - (mean_other**2).sum(1)).clamp_min(0)
    together = windowed((one * other).sum(1)) - (mean_one * mean_other).sum(1)
    return (together / ((spread_one * spread_other).sqrt() + TEXTURE * float(one.var()) + 1e-12)).clamp(-1, 1)


def windowed(values: Tensor) -> Tensor:
    """The mean of (..., H, W) over the WINDOW around each pixel, of which only what lies in the picture counts.

    Sums of shifted pictures, first along rows, then along columns: a fifth of the time of torch's ``avg_pool2d``.
    """
    for axis in (-1, -2):
        size, half = values.shape[axis], WINDOW // 2
        total, count = values.clone(), values.new_full((size,), 1.0)
        for shift in range(1, min(half, size - 1) + 1):
            for here, there in ((0, shift), (shift, 0)):
                total.narrow(axis, here, size - shift).add_(values.narrow(axis, there, size - shift))
                count.narrow(0, here, size - shift).add_(1.0)
        values = total / (count if axis == -1 else count[:, None])
    return values


def semi_global(cost: Tensor, small: float, large: float) -> Tensor:
    """Costs (K, H, W) of K choices with what the pixels around have to say: the mean over paths from four sides.

    Along a path, with the least cost m of the last pixel: L(k) = cost(k) + min(L'(k), L'(k +- 1) + small, m + large) - m.
    """
    total = torch.zeros_like(cost)
    for axis in (1, 2):
        lines = cost.movedim(axis, 0)
        for order in (range(len(lines)), range(len(lines) - 1, -1, -1)):
            paths = torch.empty_like(lines)
            last: Tensor | None = None
            for place in order:
                path = lines[place]
                if last is not None:
                    least = last.amin(0, keepdim=True)
                    step = torch.minimum(last, least + large)
                    step[1:] = torch.minimum(step[1:], last[:-1] + small)
                    step[:-1] = torch.minimum(step[:-1], last[1:] + small)
                    path = path + step - least
                paths[place] = last = path
            total += paths.movedim(0, axis)
    return total / 4


def _between(cost: Tensor, best: Tensor) -> Tensor:
    """How far (H, W) from the best plane toward its neighbours the parabola through the three costs is least, in planes."""
    middle = best.clamp(1, len(cost) - 2)
    before, here, after = (cost.gather(0, (middle + offset)[None])[0] for offset in (-1, 0, 1))
    bend = before - 2 * here + after
    real = (bend > 1e-6) & (before < NEVER) & (after < NEVER) & (middle == best)
    return torch.where(real, 0.5 * (before - after) / bend.clamp_min(1e-6), 0).clamp(-0.5, 0.5)


# ---------------------------------------------------------------- all depth maps in one field (Curless and Levoy 1996)
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
        (there, trust), depth = looked_up(one.camera, torch.stack([one.depth, one.trust]), points, mode="nearest")
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
    inside, distance = values < 0, np.full(values.shape, FAR)
    beside = binary_dilation(inside) & binary_dilation(~inside)  # a triangle has one of its cell's corners among them
    near = distance_transform_edt(~beside) < FAR + 2
    distance[near] = cKDTree(surface).query(np.argwhere(near), distance_upper_bound=FAR)[0].clip(max=FAR)
    signed: np.ndarray = gaussian_filter(np.where(values < 0, -distance, distance), BLUR)
    found: Tensor = torch.from_numpy(signed.astype(np.float32)) * grid.step
    return DistanceGrid(found, grid.low, grid.step)
