"""Signed distances on a regular grid, below zero inside the object, the mesh of their zero, and a blur of meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve
from skimage.measure import marching_cubes
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate, normalize

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import smooth_normals
from ia_bench.geometry.unwrapping import unwrap
from ia_bench.scenes.scene import Mesh

FLATTEST = 1e-6  # least sine of an angle when its cotangent is taken, so that a needle of a triangle has a finite weight
CRUMB = 0.001  # of the largest part's triangles, a thirtieth of its size; smaller parts are noise


@dataclass(frozen=True)
class DistanceGrid:
    """Distances at the vertices of a box of cubic cells.

    ``values`` (X, Y, Z) float32, at the positions ``low`` + ``step`` (i, j, k); ``low`` (3,) float32; ``step`` in scene units.
    """

    values: Tensor
    low: Tensor
    step: float

    @property
    def high(self) -> Tensor:
        """The corner of the box opposite to ``low``, (3,)."""
        return self.low + self.step * (torch.tensor(self.values.shape) - 1)

    def positions(self) -> Tensor:
        """Where the vertices are, (X, Y, Z, 3)."""
        axes = (torch.arange(count, dtype=torch.float32) for count in self.values.shape)
        return self.low + self.step * torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)

    def at(self, points: Tensor) -> Tensor:
        """Trilinear distances (N,) at (N, 3) points; outside of the box that of its nearest face."""
        return sampled(self.values[None], self.low, self.high, points)[:, 0]

    def refined(self) -> DistanceGrid:
        """The same distances on a grid of the same box with cells of half the size, interpolated."""
        size = tuple(2 * count - 1 for count in self.values.shape)
        values = interpolate(self.values[None, None], size, mode="trilinear", align_corners=True)[0, 0]
        return DistanceGrid(values, self.low, 0.5 * self.step)


def sampled(volume: Tensor, low: Tensor, high: Tensor, points: Tensor) -> Tensor:
    """Trilinear values (N, C) of a volume (C, X, Y, Z) over the box from ``low`` to ``high`` at (N, 3) points; differentiable."""
    place = 2 * (points - low) / (high - low) - 1
    grid = place.flip(-1)[None, None, None]
    return grid_sample(volume[None], grid, mode="bilinear", padding_mode="border", align_corners=True)[0, :, 0, 0].T


def mesh_of(grid: DistanceGrid, triangles: int) -> Mesh:
    """The zero of the distances as a mesh of about ``triangles`` at most, with their gradient as normals and new UV.

    Raises InputError where the distances have no zero.
    """
    vertices, faces = extracted(grid)
    if len(faces) > triangles:  # by the quadrics of Garland and Heckbert (1997)
        import fast_simplification

        centre, scale = vertices.mean(0), np.ptp(vertices, axis=0).max()
        fewer, kept = fast_simplification.simplify((vertices - centre) / scale, faces, target_count=triangles, agg=3.0)
        vertices, faces = np.asarray(fewer, np.float64) * scale + centre, np.asarray(kept, np.int64)
    return unwrap(vertices, faces, normals_at(grid, vertices))


def extracted(grid: DistanceGrid) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 in scene units and triangles (F, 3) of the zero, wound outward, without crumbs."""
    values = grid.values.numpy()
    if not values.min() < 0 < values.max():
        raise InputError(f"distances: expected some below and some above 0, found {values.min():g} to {values.max():g}")
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    solid = trimesh.Trimesh(vertices * grid.step + grid.low.numpy(), faces, process=False)
    parts = trimesh.graph.connected_components(solid.face_adjacency, nodes=np.arange(len(faces)), min_len=1)
    largest = max(map(len, parts))
    kept = np.concatenate([part for part in parts if len(part) >= CRUMB * largest])
    used, compact = np.unique(solid.faces[np.sort(kept)], return_inverse=True)
    return np.asarray(solid.vertices)[used], compact.reshape(-1, 3)


def normals_at(grid: DistanceGrid, vertices: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) at points on the surface: the gradient of the distances."""
    gradients = torch.stack(torch.gradient(grid.values, spacing=grid.step))
    found = sampled(gradients, grid.low, grid.high, torch.from_numpy(vertices).float())
    return normalize(found, dim=-1, eps=1e-12).numpy()


def smoothed(mesh: Mesh, width: float) -> Mesh:
    """The mesh blurred by a Gaussian of standard deviation ``width`` (scene units) along its surface, with its UV and triangles.

    One implicit Euler step of the heat equation (Desbrun et al. 1999): (M + t C) x' = M x, t = width^2 / 2, with the cotangent
    stiffness C and the vertices' areas M. Vertices at one place, as on UV seams, move together. Volume shrinks.
    """
    _, first, shared = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    places, faces = mesh.vertices[first].astype(np.float64), shared[mesh.faces]
    corners = places[faces]
    stiffness = coo_matrix((len(places), len(places)))
    for corner in range(3):
        one, two = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        a, b = places[one] - corners[:, corner], places[two] - corners[:, corner]
        sine = np.linalg.norm(np.cross(a, b), axis=1)
        lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        weight = 0.5 * (a * b).sum(1) / np.maximum(sine, FLATTEST * np.maximum(lengths, 1e-30))
        rows, columns = np.concatenate([one, two]), np.concatenate([two, one])
        stiffness = stiffness + coo_matrix((np.concatenate([weight, weight]), (rows, columns)), stiffness.shape)
    laplacian = diags(np.asarray(stiffness.sum(1)).ravel()) - stiffness
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mass = np.bincount(faces.ravel(), np.repeat(area / 3, 3), len(places))
    mass[mass == 0] = 1.0  # of a vertex in no triangle, which stays where it is
    moved = spsolve((diags(mass) + 0.5 * width**2 * laplacian).tocsc(), mass[:, None] * places)
    vertices = moved[shared]
    return replace(mesh, vertices=vertices.astype(np.float32), normals=smooth_normals(vertices, mesh.faces).astype(np.float32))
