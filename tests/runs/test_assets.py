"""The files a run leaves: EXR maps to the bit, and a glTF binary as another program reads it."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from ia_bench.material.textures import Material, fetch
from ia_bench.render.asset_files import glb
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.run import write_assets
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.scene import Mesh


@pytest.fixture
def mesh() -> Mesh:
    """Two triangles of different orientation with a seam between them; one vertex normal is no triangle's."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 0, 0], [0, 2, 0], [1, 2, 3]], np.float32)
    normals = np.array([[0, 0, 1]] * 3 + [[0.6, 0, 0.8]] * 3, np.float32)
    uv = np.array([[0.05, 0.1], [0.4, 0.1], [0.05, 0.9], [0.6, 0.2], [0.9, 0.3], [0.7, 0.95]], np.float32)
    return Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]], np.int32), normals, uv)


@pytest.fixture
def fitted(mesh: Mesh) -> TexturedReconstruction:
    generator = torch.Generator().manual_seed(0)
    albedo, roughness = torch.rand(16, 16, 3, generator=generator), torch.rand(16, 16, 1, generator=generator)
    light = 1e5 * torch.rand(8, 16, 3, generator=generator) ** 4
    return TexturedReconstruction(Stage(mesh, torch.device("cpu")), Material(albedo, roughness), light)


def opened(binary: bytes) -> trimesh.Trimesh:
    (found,) = trimesh.load(io.BytesIO(binary), file_type="glb", process=False).geometry.values()
    return found


def test_maps_are_the_textures_and_metal_is_blue_in_the_asset(tmp_path: Path, fitted: TexturedReconstruction) -> None:
    metallic = torch.linspace(0, 1, 256).reshape(16, 16, 1)
    with RunFolder(tmp_path / "run", {"a": 1}, "0") as folder:
        fitted.material = replace(fitted.material, metallic=metallic)
        write_assets(folder, fitted)
    channels = {"albedo": 3, "roughness": 1, "metallic": 1, "light": 3}
    read = {name: read_exr(tmp_path / "run" / f"{name}.exr", count) for name, count in channels.items()}
    for name in ("albedo", "roughness", "metallic"):
        np.testing.assert_array_equal(read[name], getattr(fitted.material, name))
    np.testing.assert_array_equal(read["light"], fitted.environment.texels)
    assert fitted.environment.texels.max() > 65504  # beyond half float
    material = opened((tmp_path / "run" / "asset.glb").read_bytes()).visual.material
    assert material.metallicFactor in (None, 1.0)
    packed = np.asarray(material.metallicRoughnessTexture)
    np.testing.assert_array_equal(packed[..., 2], np.arange(256).reshape(16, 16))
    np.testing.assert_array_equal(packed[..., 1], np.round(255 * fitted.material.roughness.numpy()[..., 0]))


def test_the_asset_of_a_dielectric_has_y_up(mesh: Mesh, fitted: TexturedReconstruction) -> None:
    albedo, roughness = fitted.material.albedo.numpy(), fitted.material.roughness.numpy()[..., 0]
    found = opened(glb(mesh, albedo, roughness))
    for theirs, (x, y, z) in ((found.vertices, mesh.vertices.T), (found.vertex_normals, mesh.normals.T)):
        np.testing.assert_allclose(theirs, np.stack([x, z, -y], 1), atol=1e-6)
    material = found.visual.material
    base, packed = (np.asarray(one.convert("RGB")) for one in (material.baseColorTexture, material.metallicRoughnessTexture))
    assert np.abs(base / 255 - linear_to_srgb(albedo)).max() <= 0.5 / 255 + 1e-6
    assert np.abs(packed[..., 1] / 255 - roughness).max() <= 0.5 / 255 + 1e-6
    assert (material.metallicFactor, material.roughnessFactor, material.baseColorFactor) == (0, 1, None)
    # What a viewer shows at a vertex (texel under its UV, from the top) is what we mean there.
    u, v = found.visual.uv.T
    row, column = ((1 - v) * 16).astype(int), (u * 16).astype(int)
    centre = torch.from_numpy(np.stack([(column + 0.5) / 16, 1 - (row + 0.5) / 16], 1).astype(np.float32))
    shown = linear_to_srgb(fetch(fitted.material.albedo, centre).numpy())
    np.testing.assert_allclose(base[row, column] / 255, shown, atol=0.6 / 255)
