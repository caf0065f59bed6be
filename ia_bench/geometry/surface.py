"""From a grid of distances to a mesh that can be textured: marching cubes, fewer triangles, normals, an atlas."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from skimage.measure import marching_cubes

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid, sampled
from ia_bench.geometry.mesh import unwrap
from ia_bench.scenes.scene import Mesh

CRUMB = 0.01  # of the largest part's triangles; smaller parts are noise


def mesh_of(grid: DistanceGrid, triangles: int) -> Mesh:
    """The zero of the distances as a mesh of about ``triangles`` at most, with their gradient as normals and new UV.

    Raises InputError where the distances have no zero.
    """
    vertices, faces = extracted(grid)
    if len(faces) > triangles:
        vertices, faces = decimated(vertices, faces, triangles)
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


def decimated(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface with about so many triangles, by the quadrics of Garland and Heckbert (1997)."""
    import fast_simplification

    centre, scale = vertices.mean(0), np.ptp(vertices, axis=0).max()
    fewer, kept = fast_simplification.simplify((vertices - centre) / scale, faces, target_count=triangles, agg=3.0)
    return np.asarray(fewer, np.float64) * scale + centre, np.asarray(kept, np.int64)


def normals_at(grid: DistanceGrid, vertices: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) at points on the surface: the gradient of the distances."""
    points = torch.from_numpy(vertices).float()
    gradient = sampled(grid.gradients(), grid.low, grid.high, points)
    return torch.nn.functional.normalize(gradient, dim=-1, eps=1e-12).numpy()
