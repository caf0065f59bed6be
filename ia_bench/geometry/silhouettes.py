"""Masks as distances to their outlines, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.special import ndtri
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.scenes.scene import Camera, View

HALF = 0.5  # coverage on an outline
SOFT_SHARE = 0.02  # of the pixels of a mask that an antialiased outline leaves between 0 and 1, at least
REACH = 0.5  # pixels along an outline between the nearest of its points and that of the nearest pixel, about
BLUR = 0.7  # pixels, by which a mask of zeros and ones is blurred: the staircase of its outline becomes a slope


@dataclass(frozen=True)
class Silhouette:
    """The outline of one view: ``distance`` (H, W) float32 in pixels, positive outside, and the camera that sees it."""

    camera: Camera
    distance: Tensor

    def outside(self, points: Tensor) -> Tensor:
        """How far (N, 3) points lie outside of the cone of rays that the mask lets through, (N,) scene units; below 0 inside.

        Across the ray, at the depth of the point. A point behind the camera is not seen, so nothing is known: minus infinity.
        """
        camera = self.camera
        column, row, depth = camera.project(points)
        place = torch.stack([2 * column / camera.width - 1, 2 * row / camera.height - 1], -1)[None, None]
        pixels = grid_sample(self.distance[None, None], place, mode="bilinear", padding_mode="border", align_corners=False)
        focal = 0.5 * (camera.focal[0] + camera.focal[1])
        return torch.where(depth > 0, pixels[0, 0, 0] * depth / focal, -torch.inf)


def silhouettes(views: Sequence[View]) -> list[Silhouette]:
    """The outlines of views; a pixel of which nobody knows whether it shows the object counts as object."""
    return [Silhouette(view.camera, torch.from_numpy(outline_distance(carving_mask(view)))) for view in views]


def carving_mask(view: View) -> np.ndarray:
    """The view's mask (H, W), 1 where nothing is known."""
    return view.mask if view.valid is None else np.where(view.valid | (view.mask > 0), view.mask, np.float32(1))


def outline_distance(mask: np.ndarray) -> np.ndarray:
    """Distance in pixels (H, W) float32 from each pixel's centre to the line where coverage is one half; positive outside.

    Pixels that the line runs through tell where: of a straight line, coverage falls by the length of its chord per pixel. All
    others take the line through the nearest of these, and at corners, where that would be too near, the distance of its point.
    """
    soft = (mask > 0.02) & (mask < 0.98)
    blurred = soft.sum() < SOFT_SHARE * (mask > HALF).sum()
    values = gaussian_filter(mask.astype(np.float64), BLUR) if blurred else mask.astype(np.float64)
    inside = values > HALF
    side = np.where(inside, -1.0, 1.0)
    edge = _edge_pixels(values)
    if not edge.any():  # all of the picture on one side
        return (side * np.hypot(*mask.shape)).astype(np.float32)
    slope = np.stack(np.gradient(gaussian_filter(values, 0.5)))
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


def _edge_pixels(values: np.ndarray) -> np.ndarray:
    """Of every two neighbours (H, W) on different sides of one half, that which is nearer to it; both if neither is."""
    inside, away = values > HALF, np.abs(values - HALF)
    edge = np.zeros(values.shape, bool)
    for one, two in (((slice(None, -1),), (slice(1, None),)), ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))):
        crossed = inside[one] != inside[two]
        edge[one] |= crossed & (away[one] <= away[two])
        edge[two] |= crossed & (away[two] <= away[one])
    return edge


def centre_of(views: Sequence[View]) -> np.ndarray:
    """The point (3,) that is nearest, by least squares, to the rays from the cameras through the middles of the masks."""
    origins, directions = [], []
    for view in views:
        row, column = (places.mean() + 0.5 for places in np.nonzero(view.mask > HALF))
        direction = view.camera.rays(column, row)
        origins.append(view.camera.position)
        directions.append(direction / np.linalg.norm(direction))
    across = np.eye(3) - np.einsum("ni,nj->nij", directions, directions)  # takes the part along a ray away
    point: np.ndarray = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, origins), rcond=None)[0]
    return point
