"""Views of objects, traced once and kept: what each pixel sees, and which directions of light it can be lit from.

Rays are most of the cost of a training image. They do not depend on materials or lights, so a view is traced once, and is another
image each time that :mod:`ia_bench_training.world.shade` gives it other ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.material.brdf import dot, normalize
from ia_bench.render.asset_files import read_asset
from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.rays import EmbreeRays
from ia_bench.render.reconstruction import Assets
from ia_bench.scenes.scene import Camera, Mesh
from ia_bench_training.cameras import draw_camera
from ia_bench_training.objects import make_object, tilt
from ia_bench_training.patterns import on_surface
from ia_bench_training.render import MAX_COVERAGE, MIN_COVERAGE
from ia_bench_training.shading import OFFSET
from ia_bench_training.world.layout import MISS, POINTS, SIDE, directions

DRESSED = 0.25  # share of the views of a real mesh that wear other textures than its own


@dataclass(frozen=True)
class Shape:
    """Triangles with what materials need: ``normals`` (F, 3, 3) and ``uv`` (F, 3, 2) of corners, ``slot`` (F,) of faces.

    ``atlas`` is the number of the textures that belong to the mesh, -1 where the slots' materials are to be drawn.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    slot: np.ndarray
    atlas: int


def procedural(rng: Generator) -> Shape:
    """A new object of the generator."""
    solid = make_object(rng)
    return Shape(solid.vertices, solid.faces, solid.normals, _projected(solid.local, solid.axis), solid.slot, -1)


def _projected(corners: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Texture coordinates (F, 3, 2) of corners (F, 3, 3): along the axis (F,) that each triangle faces most."""
    along = torch.from_numpy(axis).repeat_interleave(3)
    return on_surface(torch.from_numpy(corners).reshape(-1, 3), along).numpy().reshape(-1, 3, 2)


def real(asset: Assets, atlas: int, rng: Generator) -> Shape:
    """A real mesh in the unit ball, a little tilted, in its own textures or, DRESSED, in one that is drawn."""
    mesh, pose = asset.mesh, tilt(rng, 0.12)
    vertices, normals = mesh.vertices @ pose.T, (mesh.normals @ pose.T)[mesh.faces]
    vertices = vertices - (vertices.min(0) + vertices.max(0)) / 2
    vertices = (vertices / np.linalg.norm(vertices, axis=1).max()).astype(np.float32)
    corners = vertices[mesh.faces]
    uv = mesh.uv[mesh.faces]
    if rng.random() < DRESSED:
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        atlas, uv = -1, _projected(corners, np.abs(facing).argmax(1))
    slot = np.zeros(len(mesh.faces), np.int64)
    return Shape(vertices, mesh.faces, normals.astype(np.float32), uv.astype(np.float32), slot, atlas)


def load_mesh(path: Path) -> Assets | None:
    """A real object, z up; None where its textures repeat, which nothing here can draw."""
    try:
        return read_asset(path, note=lambda _: None)
    except InputError:
        return None


@torch.no_grad()
def trace(shape: Shape, rng: Generator, views: int, size: int) -> list[dict[str, Tensor]]:
    """Up to ``views`` views of ``size`` pixels a side; those that see too little or too much are left out.

    Tensors of a view by name, of its P pixels that see the object: ``pixel`` (P,) int32; ``uv`` (P, POINTS, 2) float16; ``slot``
    (P, POINTS) uint8, MISS where a point sees nothing; ``normal`` and ``toward`` the camera (P, 3) int8, in the world;
    ``sky`` (P, DIRECTIONS / 8) uint8, a bit for each direction from which light reaches the surface. And ``camera`` to
    world (3, 3).
    """
    empty = np.zeros((0, 3), np.float32)
    rays = EmbreeRays(Mesh(shape.vertices, shape.faces, empty, empty))
    corners = torch.from_numpy(shape.vertices)[torch.from_numpy(shape.faces).long()]
    flat = normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    table = torch.cat([corners, torch.from_numpy(shape.normals).float(), torch.from_numpy(shape.uv).float()], -1)
    slots, found = torch.from_numpy(shape.slot), []
    for _ in range(views):
        camera = draw_camera(rng, shape.vertices, size)
        origin, direction = (torch.from_numpy(part).reshape(-1, 3) for part in primary_rays(camera, SIDE))
        face, barycentric, _ = rays.intersect(origin, direction, coherent=True)
        face, barycentric = face.reshape(-1, POINTS), barycentric.reshape(-1, POINTS, 2)
        hit = face >= 0
        if MIN_COVERAGE < float(hit.float().mean()) < MAX_COVERAGE:
            found.append(_view(camera, rays, table, flat, slots, face, barycentric))
    return found


def _view(
    camera: Camera, rays: EmbreeRays, table: Tensor, flat: Tensor, slots: Tensor, face: Tensor, barycentric: Tensor
) -> dict[str, Tensor]:
    pixel = torch.nonzero((face >= 0).any(1))[:, 0]
    face, barycentric = face[pixel], barycentric[pixel]
    hit = face >= 0
    weight = torch.cat([1 - barycentric.sum(-1, keepdim=True), barycentric], -1)
    values = torch.einsum("pkw,pkwc->pkc", weight, table[face.clamp_min(0)])
    first = hit.int().argmax(1)[:, None, None]  # the point whose light stands for the pixel's
    position, normal, _ = values.gather(1, first.expand(-1, 1, values.shape[2]))[:, 0].split([3, 3, 2], -1)
    geometric = flat[face.gather(1, first[..., 0])[:, 0]]
    toward = normalize(torch.from_numpy(camera.position).float() - position)
    side = torch.where(dot(geometric, toward) < 0, -1.0, 1.0)
    normal = normalize(normal) * torch.where(dot(normal, geometric) < 0, -side, side)
    geometric, cosine = geometric * side, dot(normal, toward)
    normal = torch.where(cosine < 1e-3, normalize(normal + (2e-3 - cosine) * toward), normal)
    lit = (geometric @ directions().T > 0) & (normal @ directions().T > 0)
    sky = lit & ~rays.occluded(position + OFFSET * geometric, directions().expand(len(pixel), -1, -1), lit)
    return {
        "pixel": pixel.int(),
        "uv": values[..., 6:].half(),
        "slot": torch.where(hit, slots[face.clamp_min(0)], MISS).byte(),
        "normal": (127 * normal).round().to(torch.int8),
        "toward": (127 * toward).round().to(torch.int8),
        "sky": torch.from_numpy(np.packbits(sky.numpy(), axis=1, bitorder="little")),
        "camera": torch.from_numpy(camera.to_world[:3, :3]).float(),
    }


def gathered(views: Sequence[dict[str, Tensor]], atlases: Sequence[int]) -> dict[str, Tensor]:
    """Views as the tensors of a file: pixels after another, ``start`` (V + 1,) where each begins, ``atlas`` (V,)."""
    start = np.cumsum([0, *(len(view["pixel"]) for view in views)])
    whole = {name: torch.cat([view[name] for view in views]) for name in views[0] if name != "camera"}
    camera = torch.stack([view["camera"] for view in views])
    return {**whole, "camera": camera, "start": torch.from_numpy(start), "atlas": torch.tensor(list(atlases))}
