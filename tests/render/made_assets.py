"""Meshes with textures as other programs write them, made by trimesh and by hand."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

from ia_bench.material.textures import fetch
from ia_bench.render.asset_files import read_asset
from ia_bench.render.reconstruction import Assets
from ia_bench.scenes.scene import Mesh

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 3.0]])
FACES = np.array([[0, 1, 2], [1, 3, 2]])
UV = np.array([[0.05, 0.1], [0.9, 0.1], [0.05, 0.95], [0.8, 0.9]])
HALF = np.float32(0.5 / 255 + 1e-6)


def read(path: Path, **options: Any) -> tuple[Assets, list[str]]:
    notes = list[str]()
    return read_asset(path, note=notes.append, **options), notes


def picture(seed: int, height: int = 8, width: int = 8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def at(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """What a renderer finds in a texture (H, W[, C]) at UV (N, 2)."""
    return fetch(torch.from_numpy(np.atleast_3d(texture)).float(), torch.from_numpy(uv).float()).numpy()


def at_corner(asset: Assets, texture: np.ndarray, place: np.ndarray) -> np.ndarray:
    """What the asset's texture holds at the vertex that lies at ``place``."""
    nearest = np.abs(asset.mesh.vertices - place).sum(-1).argmin()
    return at(texture, asset.mesh.uv[nearest : nearest + 1])[0]


def gltf(path: Path, change: Callable[[dict[str, Any]], None], uv: np.ndarray = UV, **material: Any) -> Path:
    """A .glb by trimesh of one square with ``material``, whose JSON is then changed."""
    visual = trimesh.visual.TextureVisuals(uv=uv, material=PBRMaterial(**material))
    content = trimesh.Scene(trimesh.Trimesh(VERTICES, FACES, visual=visual, process=False)).export(file_type="glb")
    size = struct.unpack_from("<I", content, 12)[0]
    header = json.loads(content[20 : 20 + size])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    start = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(content) - 20 - size, len(text), b"JSON")
    path.write_bytes(start + text + content[20 + size :])
    return path


def obj(folder: Path, mtl: str, faces: str = "usemtl one\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n", **pictures: np.ndarray) -> Path:
    """An OBJ of the square with that text as its materials, and pictures NAME.png beside it."""
    for name, values in pictures.items():
        Image.fromarray(values).save(folder / f"{name}.png")
    lines = ["mtllib my materials.mtl", *(f"v {x} {y} {z}" for x, y, z in VERTICES), *(f"vt {u} {v}" for u, v in UV)]
    (folder / "my materials.mtl").write_text(mtl)
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n" + faces)
    return folder / "mesh.obj"


def square() -> Mesh:
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    return Mesh(VERTICES.astype(np.float32), FACES.astype(np.int32), normals, UV.astype(np.float32))
