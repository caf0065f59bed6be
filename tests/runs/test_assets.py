"""The files a run leaves: EXR maps to the bit, and a glTF binary read back without the code that wrote it."""

import io
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

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


def chunks(binary: bytes) -> tuple[dict, bytes]:
    """JSON and binary chunk of a GLB file, by its specification."""
    magic, version, length = struct.unpack_from("<4sII", binary)
    assert (magic, version, length) == (b"glTF", 2, len(binary))
    size, kind = struct.unpack_from("<I4s", binary, 12)
    assert kind == b"JSON"
    description = json.loads(binary[20 : 20 + size])
    rest, kind = struct.unpack_from("<I4s", binary, 20 + size)
    assert kind == b"BIN\0"
    return description, binary[28 + size : 28 + size + rest]


def accessor(description: dict, data: bytes, index: int) -> np.ndarray:
    """Values of a float accessor, (count, components)."""
    entry = description["accessors"][index]
    view = description["bufferViews"][entry["bufferView"]]
    width = {"VEC2": 2, "VEC3": 3}[entry["type"]]
    assert entry["componentType"] == 5126
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    return np.frombuffer(data, "<f4", entry["count"] * width, start).reshape(-1, width)


def texture(description: dict, data: bytes, index: int) -> np.ndarray:
    """An embedded image by texture index, (H, W, C) uint8, row 0 at the top."""
    image = description["images"][description["textures"][index]["source"]]
    view = description["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    return np.asarray(Image.open(io.BytesIO(data[start : start + view["byteLength"]])).convert("RGB"))


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
    description, data = chunks((tmp_path / "run" / "asset.glb").read_bytes())
    found = description["materials"][0]["pbrMetallicRoughness"]
    assert found.get("metallicFactor", 1.0) == 1.0
    packed = texture(description, data, found["metallicRoughnessTexture"]["index"])
    np.testing.assert_array_equal(packed[..., 2], np.arange(256).reshape(16, 16))
    np.testing.assert_array_equal(packed[..., 1], np.round(255 * fitted.material.roughness.numpy()[..., 0]))


def test_glb_by_its_specification(mesh: Mesh, fitted: TexturedReconstruction) -> None:
    albedo, roughness = fitted.material.albedo.numpy(), fitted.material.roughness.numpy()[..., 0]
    description, data = chunks(glb(mesh, albedo, roughness))
    assert description["asset"]["version"] == "2.0"
    (part,) = description["meshes"][0]["primitives"]
    x, y, z = mesh.vertices.T
    position = accessor(description, data, part["attributes"]["POSITION"])
    np.testing.assert_array_equal(position, np.stack([x, z, -y], 1))  # z up becomes y up, a rotation
    nx, ny, nz = mesh.normals.T
    normal = accessor(description, data, part["attributes"]["NORMAL"])
    np.testing.assert_allclose(normal, np.stack([nx, nz, -ny], 1), atol=1e-6)
    uv = accessor(description, data, part["attributes"]["TEXCOORD_0"])
    np.testing.assert_allclose(uv, np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], 1), atol=1e-6)  # glTF: from the top

    material = description["materials"][part["material"]]["pbrMetallicRoughness"]
    base = texture(description, data, material["baseColorTexture"]["index"])
    assert np.abs(base / 255 - linear_to_srgb(albedo)).max() <= 0.5 / 255 + 1e-6
    packed = texture(description, data, material["metallicRoughnessTexture"]["index"])
    assert np.abs(packed[..., 1] / 255 - roughness).max() <= 0.5 / 255 + 1e-6
    assert material["metallicFactor"] == 0
    assert material.get("roughnessFactor", 1) == 1
    assert material.get("baseColorFactor", [1, 1, 1, 1]) == [1, 1, 1, 1]
    # What a viewer shows at a vertex (texel under its UV, from the top) is what we mean there.
    row, column = (uv[:, 1] * 16).astype(int), (uv[:, 0] * 16).astype(int)
    centre = torch.from_numpy(np.stack([(column + 0.5) / 16, 1 - (row + 0.5) / 16], 1).astype(np.float32))
    shown = linear_to_srgb(fetch(fitted.material.albedo, centre).numpy())
    np.testing.assert_allclose(base[row, column] / 255, shown, atol=0.6 / 255)
