"""A mesh without its detail: heat flow of the vertices over the surface, as a Gaussian blur of a picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve

from ia_bench.scenes.scene import Mesh

FLATTEST = 1e-6  # least sine of a triangle's angle that its cotangent is taken of


def smoothed(mesh: Mesh, width: float) -> Mesh:
    """The mesh blurred by a Gaussian of standard deviation ``width`` (scene units) along its surface, with its UV and triangles.

    One implicit Euler step of the heat equation (Desbrun et al. 1999): (M + t C) x' = M x, t = width^2 / 2, with the cotangent
    stiffness C and the vertices' areas M. Vertices at one place, as on UV seams, move together. Volume shrinks.
    """
    _, first, shared = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    shared = shared.reshape(-1)
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
    moved = spsolve((diags(mass) + 0.5 * width**2 * laplacian).tocsc(), mass[:, None] * places)
    normals = np.asarray(trimesh.Trimesh(moved, faces, process=False).vertex_normals)[shared]
    return replace(mesh, vertices=moved[shared].astype(np.float32), normals=normals.astype(np.float32))
