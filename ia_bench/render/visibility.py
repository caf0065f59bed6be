"""Whether a surface point sees the light in a direction: traced, baked once per mesh, or not asked at all."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.light.latlong import direction_to_texel, texel_to_direction
from ia_bench.render.atlas import Atlas, cache_folder, kept_bake
from ia_bench.render.gbuffer import SurfaceInterpolator, SurfacePoints
from ia_bench.render.rays import RayCaster
from ia_bench.scenes.scene import Mesh

BAKE_SIZE = 256  # texels along a side of the visibility texture
BAKE_ROWS = 32  # rows of the lat-long grid of directions; twice as many columns
BAKE_CHUNK = 512  # texels traced at once


class Visibility(Protocol):
    """What the estimator asks of shadows."""

    def blocked(self, points: SurfacePoints, index: Tensor, direction: Tensor) -> Tensor:
        """Whether the mesh is in the way of (M,) points of ``points`` by ``index`` in (M, 3) directions: (M,) bool."""
        ...


class NoShadows:
    """For convex objects: nothing ever blocks."""

    def blocked(self, points: SurfacePoints, index: Tensor, direction: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        return torch.zeros(len(index), dtype=torch.bool, device=direction.device)


class TracedShadows:
    """A ray per question, from a point lifted off its triangle by ``offset``. Exact."""

    def __init__(self, rays: RayCaster, offset: float) -> None:
        self._rays, self._offset = rays, offset

    def blocked(self, points: SurfacePoints, index: Tensor, direction: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        origin = points.position + self._offset * points.geometric
        return self._rays.occluded(origin[index], direction)


class BakedShadows:
    """Visibility of every texel of the UV atlas along one stratified direction in each cell of a lat-long grid.

    One bit per texel and cell, looked up by nearest neighbour in both, so shadow edges are as coarse as a texel and a
    cell. Geometry does not change during a fit: the bake is kept in a cache and reused by every run over the same mesh.
    """

    def __init__(self, bits: Tensor, atlas: Atlas) -> None:
        """``bits`` (N, cells / 8) uint8 of the N texels of ``atlas``."""
        self._bits, self._atlas = bits, atlas

    def blocked(self, points: SurfacePoints, index: Tensor, direction: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        cell = direction_to_texel(direction, BAKE_ROWS, 2 * BAKE_ROWS)
        byte = self._bits[self._atlas.nearest(points.uv)[index], cell // 8]
        return (byte >> (7 - cell % 8).to(torch.uint8)) & 1 == 1


def make_visibility(kind: str, mesh: Mesh, surface: SurfaceInterpolator, rays: RayCaster) -> Visibility:
    """The visibility named by ``render.shadows``. Raises InputError for another name."""
    if kind == "none":
        return NoShadows()
    if kind == "traced":
        return TracedShadows(rays, surface.offset)
    if kind == "baked":
        return bake(mesh, surface, rays, cache_folder())
    raise InputError(f"render.shadows: expected auto, traced, baked or none, found {kind!r}")


def bake(mesh: Mesh, surface: SurfaceInterpolator, rays: RayCaster, cache: Path) -> BakedShadows:
    """Trace the bake of a mesh, or read it from the cache."""
    atlas = Atlas.of(mesh, BAKE_SIZE, surface.device)
    arrays = kept_bake("visibility", mesh, (BAKE_SIZE, BAKE_ROWS), cache, lambda: {"bits": _trace_bits(surface, rays, atlas)})
    return BakedShadows(torch.from_numpy(arrays["bits"]).to(surface.device), atlas)


def _trace_bits(surface: SurfaceInterpolator, rays: RayCaster, atlas: Atlas) -> np.ndarray:
    """Blocked bits (N, cells / 8) of every covered texel, traced from the side of the triangle that the direction is on.

    Both sides: a sheet may be seen from behind, and a cell on the horizon is asked from above it.
    """
    cells = torch.arange(2 * BAKE_ROWS * BAKE_ROWS)
    generator = torch.Generator().manual_seed(0)
    packed = []
    for texel in torch.arange(len(atlas.face)).split(BAKE_CHUNK):
        normal, position = surface.geometry(atlas.face[texel], atlas.barycentric[texel])
        down, across = torch.rand(2, len(texel), len(cells), generator=generator)
        direction = texel_to_direction(cells.expand(len(texel), -1), down, across, BAKE_ROWS, 2 * BAKE_ROWS).to(surface.device)
        side = torch.where((direction * normal[:, None]).sum(-1, keepdim=True) > 0, 1.0, -1.0)
        origin = position[:, None] + surface.offset * side * normal[:, None]
        blocked = rays.occluded(origin.reshape(-1, 3), direction.reshape(-1, 3)).reshape(direction.shape[:2])
        packed.append(np.packbits(blocked.cpu().numpy(), axis=1))
    return np.concatenate(packed)
