"""Some of the training views: which ones a prior is asked about, and their part of the G-buffer."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.rays import RayCaster
from ia_bench.scenes.scene import Camera, Scene, farthest_first

GRAZING = 0.2
"""Cosine below which a pixel shows a surface too obliquely for a prior to say much about it."""


def evenly_spread(scene: Scene, count: int | str) -> tuple[int, ...]:
    """At most ``count`` training views ("all": every one) in their order, spread over the directions of the cameras."""
    if count == "all" or int(count) >= len(scene.train):
        return tuple(range(len(scene.train)))
    return tuple(sorted(spreading_order(scene, int(count))))


def spreading_order(scene: Scene, count: int) -> list[int]:
    """The first ``count`` training views by farthest-point sampling of the directions from the mesh to the cameras."""
    vertices = scene.expect_mesh().vertices
    return farthest_first(scene.train, 0.5 * (vertices.min(0) + vertices.max(0)))[:count]


def sees(cameras: list[Camera], positions: Tensor, normals: Tensor, rays: RayCaster, offset: float) -> Tensor:
    """Which cameras see which surface points well: (N, V) bool for (N, 3) positions with normals.

    Inside the image, at a cosine of at least GRAZING, and nothing between; ``offset``: of the shadow rays, scene units.
    """
    found = torch.zeros(len(positions), len(cameras), dtype=torch.bool, device=positions.device)
    for index, camera in enumerate(cameras):
        toward = positions.new_tensor(camera.position) - positions
        directions = toward / toward.norm(dim=-1, keepdim=True)
        column, row, depth = camera.project(positions)
        framed = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        candidates = torch.nonzero(framed & ((normals * directions).sum(-1) >= GRAZING))[:, 0]
        starts = positions[candidates] + offset * normals[candidates]
        found[candidates, index] = ~rays.occluded(starts, directions[candidates])
    return found


def views_needed(seen: Tensor, per_point: int, share: float) -> int:
    """How many of the views, in the order of the columns of ``seen`` (N, V) bool, show the points often enough.

    At least ``share`` of the points (of those that any view sees) by ``per_point`` views each, or by all that see them.
    """
    counts = seen.long().cumsum(1)
    counts = counts[counts[:, -1] > 0]
    if not len(counts):
        return seen.shape[1]
    wanted = counts[:, -1:].clamp(max=per_point)
    enough = (counts >= wanted).double().mean(0)
    return int((enough >= share).int().argmax()) + 1


def restrict(gbuffer: GBuffer, views: tuple[int, ...]) -> tuple[GBuffer, Tensor]:
    """The G-buffer of some views (ascending), and the entries (P',) of the whole one that it holds."""
    count, height, width = gbuffer.shape
    size = height * width
    rank = torch.full((count,), -1, dtype=torch.int64, device=gbuffer.pixel.device)
    rank[list(views)] = torch.arange(len(views), device=rank.device)
    place = rank[gbuffer.view()]
    rows = torch.nonzero(place >= 0)[:, 0]
    part = GBuffer(
        face=gbuffer.face[rows],
        barycentric=gbuffer.barycentric[rows],
        pixel=place[rows] * size + gbuffer.pixel[rows] % size,
        origin=gbuffer.origin[list(views)],
        shape=(len(views), height, width),
    )
    return part, rows
