"""Some of the training views: which ones a prior is asked about, and their part of the G-buffer."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ia_bench.render.gbuffer import GBuffer
from ia_bench.scenes.scene import Scene


def evenly_spread(scene: Scene, count: int | str) -> tuple[int, ...]:
    """At most ``count`` training views ("all": every one) in their order, spread over the directions of the cameras.

    Farthest-point sampling of the directions from the middle of the mesh to the cameras, from the first view on: every
    next view is the one whose direction is farthest from all chosen ones.
    """
    total = len(scene.train)
    if count == "all" or int(count) >= total:
        return tuple(range(total))
    middle = 0.5 * (scene.mesh.vertices.min(0) + scene.mesh.vertices.max(0))
    directions = np.stack([view.camera.to_world[:3, 3] for view in scene.train]) - middle
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    chosen = [0]
    nearest = directions @ directions[0]  # cosine to the nearest chosen direction
    for _ in range(int(count) - 1):
        nearest[chosen] = np.inf
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return tuple(sorted(chosen))


def restrict(gbuffer: GBuffer, views: tuple[int, ...]) -> tuple[GBuffer, Tensor]:
    """The G-buffer of some views (ascending), and the entries (P',) of the whole one that it holds."""
    count, height, width = gbuffer.shape
    size = height * width
    rank = torch.full((count,), -1, dtype=torch.int64, device=gbuffer.pixel.device)
    rank[list(views)] = torch.arange(len(views), device=rank.device)
    place = rank[gbuffer.pixel // size]
    rows = torch.nonzero(place >= 0)[:, 0]
    part = GBuffer(
        face=gbuffer.face[rows],
        barycentric=gbuffer.barycentric[rows],
        pixel=place[rows] * size + gbuffer.pixel[rows] % size,
        origin=gbuffer.origin[list(views)],
        shape=(len(views), height, width),
    )
    return part, rows
