"""Stored normals of meshes of several parts, and of glTF files, whose parts are always placed by a matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from trimesh.visual import TextureVisuals

from ia_bench.geometry.mesh import load_mesh
from ia_bench.runs.assets import glb
from ia_bench.scenes.scene import Scene

HARD = np.array([[0.6, 0.0, 0.8]] * 3)
"""Normals of a triangle in the plane z = 0 that no program would compute from it."""


def part(normals: np.ndarray | None, place: float = 0.0) -> trimesh.Trimesh:
    """A triangle with texture coordinates, from ``place`` on, with these normals (3, 3), or none."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    uv = TextureVisuals(uv=place + 0.4 * corners[:, :2])
    return trimesh.Trimesh(corners, [[0, 1, 2]], vertex_normals=normals, visual=uv, process=False)


def written(path: Path, *parts: tuple[trimesh.Trimesh, np.ndarray]) -> Path:
    """A glTF file of these parts, each placed by its matrix (4, 4)."""
    scene = trimesh.Scene()
    for number, (mesh, matrix) in enumerate(parts):
        scene.add_geometry(mesh, geom_name=f"part {number}", node_name=f"node {number}", transform=matrix)
    path.write_bytes(scene.export(file_type="glb"))
    return path


def placing(linear: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, (3, 1, 2)
    return matrix


def test_normals_of_a_run_s_own_asset_come_back(tmp_path: Path, tiny: Scene) -> None:
    mesh = tiny.expect_mesh()
    (tmp_path / "asset.glb").write_bytes(glb(mesh, np.full((4, 4, 3), 0.5), np.full((4, 4), 0.5)))
    found, notes = load_mesh(tmp_path / "asset.glb")
    assert notes == ()
    x, y, z = mesh.normals.T
    np.testing.assert_allclose(found.normals, np.stack([x, z, -y], 1), atol=1e-5)  # +y up, as glTF has it


def test_a_turned_asset_is_the_mesh_that_it_was_made_of(tmp_path: Path, tiny: Scene) -> None:
    """As the documents turn it."""
    mesh = tiny.expect_mesh()
    (tmp_path / "asset.glb").write_bytes(glb(mesh, np.full((4, 4, 3), 0.5), np.full((4, 4), 0.5)))
    loaded = trimesh.load(tmp_path / "asset.glb")
    loaded.apply_transform([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    loaded.export(tmp_path / "mesh.glb")
    found, notes = load_mesh(tmp_path / "mesh.glb")
    assert notes == ()
    np.testing.assert_allclose(found.vertices, mesh.vertices, atol=1e-5)
    np.testing.assert_allclose(found.normals, mesh.normals, atol=1e-5)


@pytest.mark.parametrize(
    "linear", [Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.diag([2.0, 0.5, 3.0]), np.diag([1.0, 1.0, -1.0])]
)
def test_normals_turn_with_their_part(tmp_path: Path, linear: np.ndarray) -> None:
    """They stay at right angles to what was in their plane, and on their side of it, however a part is turned, scaled, mirrored."""
    path = written(tmp_path / "mesh.glb", (part(HARD), np.eye(4)), (part(HARD, 0.5), placing(linear)))
    mesh, notes = load_mesh(path)
    assert notes == ()
    far = mesh.vertices[:, 2] > 1  # the part that is placed
    moved = mesh.normals[far]
    np.testing.assert_allclose(mesh.normals[~far], HARD, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1, atol=1e-5)
    for across in ([0.0, 1, 0], [-0.8, 0, 0.6]):  # at right angles to HARD
        np.testing.assert_allclose(moved @ (linear @ across), 0, atol=1e-5)
    assert (moved @ (linear @ HARD[0]) > 0).all()


def test_a_part_without_normals_is_told_of(tmp_path: Path) -> None:
    mesh, notes = load_mesh(written(tmp_path / "mesh.glb", (part(HARD), np.eye(4)), (part(None, 0.5), placing(np.eye(3)))))
    assert notes == ("mesh.glb: stored normals are zero or not finite in places; smooth normals computed instead",)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 6, atol=1e-6)
