"""Objects that are modelled but not shipped: their meshes as Blender makes them, seen from the cameras by another ray caster.

Needs `.venv-blender` (any `make scenes` makes it); skipped without.
"""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from recipe_modules import RECIPES, ROOT, cameras, mesh

BLENDER = ROOT / ".venv-blender" / "bin" / "python"
PIXELS = 48

BUILD = """
import importlib, sys
import bpy, numpy as np
from geometry import corners, join_scene
bpy.ops.wm.read_factory_settings(use_empty=True)
importlib.import_module(f"objects.{sys.argv[1]}").build()
found = corners(join_scene().data)
np.savez(sys.argv[2], positions=found.positions, faces=found.vertex, normals=found.normals)
"""


@pytest.mark.slow
@pytest.mark.skipif(not BLENDER.exists(), reason="needs .venv-blender")
@pytest.mark.parametrize("name", ["fruit", "bear"])
def test_cameras_see_only_the_outside_of_a_mesh_within_bounds(name: str, tmp_path: Path) -> None:
    subprocess.run([BLENDER, "-c", BUILD, name, tmp_path / "mesh.npz"], cwd=RECIPES, check=True, capture_output=True)
    with np.load(tmp_path / "mesh.npz") as file:
        positions, faces, normals = file["positions"], file["faces"], file["normals"]
    corner = positions[faces]
    mesh.check(mesh.weld(corner, normals, np.zeros((*faces.shape, 2), np.float32)))  # triangles, radius, normals
    assert 8_000 <= len(faces) <= mesh.MAX_TRIANGLES
    assert 0.9 < np.linalg.norm(positions, axis=1).max() <= 1.0  # and fills the frame

    seen = trimesh.Trimesh(positions, faces, process=False)
    across = (2 * np.arange(PIXELS) + 1) / PIXELS - 1
    x, y = np.meshgrid(across, -across)
    local = np.stack([x, y, -np.ones_like(x) / np.tan(cameras.FIELD_OF_VIEW / 2)], axis=-1).reshape(-1, 3)
    hits = 0
    for pose in cameras.split_poses("train", 12):
        directions = local @ pose[:3, :3].T
        first = seen.ray.intersects_first(np.tile(pose[:3, 3], (len(local), 1)), directions)
        facing = np.einsum("ij,ij->i", seen.face_normals[first[first >= 0]], directions[first >= 0])
        hits += len(facing)
        assert (facing < 0).all()
    assert hits > 0.15 * 12 * PIXELS**2
