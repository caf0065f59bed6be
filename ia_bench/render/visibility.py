"""Whether a surface point sees the light in a direction: traced, baked once per mesh, or not asked at all."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ia_bench.errors import InputError
from ia_bench.light.latlong import direction_to_texel, texel_to_direction
from ia_bench.render.gbuffer import SurfaceInterpolator, SurfacePoints
from ia_bench.render.rays import EmbreeRays, RayCaster
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

    def __init__(self, bits: Tensor, texel_row: Tensor) -> None:
        """``bits`` (N, cells / 8) uint8 of N covered texels, ``texel_row`` (size, size) int64 row in it of each texel."""
        self._bits, self._texel_row = bits, texel_row

    def blocked(self, points: SurfacePoints, index: Tensor, direction: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        size = len(self._texel_row)
        column = (points.uv[:, 0] * size).long().clamp(0, size - 1)
        row = ((1 - points.uv[:, 1]) * size).long().clamp(0, size - 1)
        cell = direction_to_texel(direction, BAKE_ROWS, 2 * BAKE_ROWS)
        byte = self._bits[self._texel_row[row, column][index], cell // 8]
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


def cache_folder() -> Path:
    """Where bakes are kept: ``$IA_BENCH_CACHE``, or ``ia_bench`` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("IA_BENCH_CACHE") or Path(base) / "ia_bench")


def bake(mesh: Mesh, surface: SurfaceInterpolator, rays: RayCaster, cache: Path) -> BakedShadows:
    """Trace the bake of a mesh, or read it from the cache."""
    digest = hashlib.sha256(f"{BAKE_SIZE} {BAKE_ROWS}".encode())
    for array in (mesh.vertices, mesh.faces, mesh.uv):
        digest.update(np.ascontiguousarray(array).tobytes())
    path = cache / f"visibility-{digest.hexdigest()[:16]}.npz"
    covered, face, barycentric = _texel_points(mesh)
    if path.is_file():
        with np.load(path) as saved:
            bits = saved["bits"]
    else:
        bits = _trace_bits(surface, rays, face, barycentric)
        cache.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.stem}.{os.getpid()}.npz")
        np.savez_compressed(partial, bits=bits)
        os.replace(partial, path)
    return BakedShadows(torch.from_numpy(bits).to(surface.device), _nearest_covered(covered).to(surface.device))


def _texel_points(mesh: Mesh) -> tuple[np.ndarray, Tensor, Tensor]:
    """Which texel centres lie on a triangle of the atlas (size, size) bool, and on which: found by rays through the UV plane."""
    flat = np.concatenate([mesh.uv, np.zeros_like(mesh.uv[:, :1])], 1)
    plane = EmbreeRays(Mesh(flat, mesh.faces, mesh.normals, mesh.uv))
    centres = (np.arange(BAKE_SIZE, dtype=np.float32) + 0.5) / BAKE_SIZE
    v, u = np.meshgrid(1 - centres, centres, indexing="ij")
    origins = torch.from_numpy(np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3).astype(np.float32))
    face, barycentric, _ = plane.intersect(origins, torch.tensor([0.0, 0.0, -1.0]).expand_as(origins).contiguous())
    hit = face >= 0
    return hit.reshape(BAKE_SIZE, BAKE_SIZE).numpy(), face[hit], barycentric[hit]


def _trace_bits(surface: SurfaceInterpolator, rays: RayCaster, face: Tensor, barycentric: Tensor) -> np.ndarray:
    """Blocked bits (N, cells / 8) of every covered texel, traced from the side of the triangle that the direction is on.

    Both sides: a sheet may be seen from behind, and a cell on the horizon is asked from above it.
    """
    cells = torch.arange(2 * BAKE_ROWS * BAKE_ROWS)
    generator = torch.Generator().manual_seed(0)
    packed = []
    for texel in torch.arange(len(face)).split(BAKE_CHUNK):
        normal, position = surface.geometry(face[texel], barycentric[texel])
        down, across = torch.rand(2, len(texel), len(cells), generator=generator)
        direction = texel_to_direction(cells.expand(len(texel), -1), down, across, BAKE_ROWS, 2 * BAKE_ROWS).to(surface.device)
        side = torch.where((direction * normal[:, None]).sum(-1, keepdim=True) > 0, 1.0, -1.0)
        origin = position[:, None] + surface.offset * side * normal[:, None]
        blocked = rays.occluded(origin.reshape(-1, 3), direction.reshape(-1, 3)).reshape(direction.shape[:2])
        packed.append(np.packbits(blocked.cpu().numpy(), axis=1))
    return np.concatenate(packed)


def _nearest_covered(covered: np.ndarray) -> Tensor:
    """Row of the nearest covered texel for every texel, (size, size) int64."""
    from scipy.ndimage import distance_transform_edt

    row_of = np.full(covered.shape, -1, np.int64)
    row_of[covered] = np.arange(covered.sum())
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return torch.from_numpy(row_of[tuple(nearest)])
