"""Meshes and cameras with known geometry, made here rather than read."""

import math
from collections.abc import Sequence

import numpy as np
import trimesh

from ia_bench.geometry.consistency import seen_at
from ia_bench.scenes.scene import Camera, Mesh, View


def mesh_of(vertices: np.ndarray, faces: np.ndarray, *, normals: np.ndarray | None = None, uv: np.ndarray | None = None) -> Mesh:
    """A mesh; without ``normals`` every triangle is flat, for which vertices are split. UV default to the middle."""
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
    if normals is None:
        uv = None if uv is None else np.asarray(uv)[faces.reshape(-1)]
        vertices, faces = vertices[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3)
        face_normals = np.cross(vertices[1::3] - vertices[::3], vertices[2::3] - vertices[::3])
        normals = np.repeat(face_normals / np.linalg.norm(face_normals, axis=1, keepdims=True), 3, axis=0)
    if uv is None:
        uv = np.full((len(vertices), 2), 0.5)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), normals.astype(np.float32), uv.astype(np.float32))


def sphere(subdivisions: int = 3, *, radius: float = 1.0, smooth: bool = True) -> Mesh:
    """An icosphere at the origin: convex, closed."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return mesh_of(ball.vertices, ball.faces, normals=ball.vertices / radius if smooth else None)


def plate(half: float, *, height: float = 0.0, uv_scale: float = 1.0) -> Mesh:
    """A square of side 2 ``half`` at z = ``height``, facing +z; u runs along +x, v along +y, over [0, uv_scale]."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    vertices = np.column_stack([half * corners, np.full(4, height)])
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    return mesh_of(vertices, [(0, 1, 2), (0, 2, 3)], normals=normals, uv=uv_scale * (corners + 1) / 2)


def disk(radius: float, *, height: float, segments: int = 256) -> Mesh:
    """A disk at z = ``height`` around the z axis, facing -z; a regular polygon of the disk's own area."""
    angle = np.arange(segments) * (2 * math.pi / segments)
    rim = radius * math.sqrt(2 * math.pi / segments / math.sin(2 * math.pi / segments))
    vertices = np.column_stack([rim * np.cos(angle), rim * np.sin(angle), np.full(segments, height)])
    vertices = np.vstack([vertices, [(0, 0, height)]])
    faces = [(segments, (i + 1) % segments, i) for i in range(segments)]
    return mesh_of(vertices, faces, normals=np.tile([0.0, 0.0, -1.0], (segments + 1, 1)))


def together(*meshes: Mesh) -> Mesh:
    """Several meshes as one; the faces of the first come first."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]).astype(np.int32),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
    )


def soup(triangles: int, seed: int) -> Mesh:
    """Random triangles in [-1, 1]^3, flat; they cross each other."""
    centre, corner = np.split(np.random.default_rng(seed).uniform(-1, 1, (triangles, 2, 3)), 2, axis=1)
    corners = np.random.default_rng(seed + 1).uniform(-0.5, 0.5, (triangles, 3, 3)) + 0.5 * centre + 0.3 * corner
    return mesh_of(corners.reshape(-1, 3), np.arange(3 * triangles).reshape(-1, 3))


def camera_at(position: tuple[float, float, float], *, pixels: int = 32, field_of_view: float = 40.0) -> Camera:
    """A square camera at ``position`` (off the z axis, or on it with +y up) that looks at the origin; degrees."""
    backward = np.asarray(position, np.float64) / np.linalg.norm(position)
    up = np.array([0.0, 1.0, 0.0]) if abs(backward[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3] = np.column_stack([right, np.cross(backward, right), backward, position])
    focal = 0.5 * pixels / math.tan(math.radians(field_of_view) / 2)
    return Camera(to_world, (focal, focal), (pixels / 2, pixels / 2), pixels, pixels)


def unit_rays(camera: Camera) -> np.ndarray:
    """Unit directions (H, W, 3) through the centres of the pixels of an OpenGL camera, float64."""
    row, column = np.indices((camera.height, camera.width)) + 0.5
    across, down = (column - camera.centre[0]) / camera.focal[0], (row - camera.centre[1]) / camera.focal[1]
    directions = np.stack([across, -down, -np.ones_like(across)], -1) @ camera.to_world[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def wrong_by(views: Sequence[View], true: Sequence[View], points: np.ndarray) -> float:
    """Pixels by which the cameras move points (N, 3) in their images, root mean square."""
    apart = [seen_at(v.camera, points) - seen_at(t.camera, points) for v, t in zip(views, true, strict=True)]
    return float(np.sqrt(np.mean([(one**2).sum(-1).mean() for one in apart])))


def bowl(radius: float = 1.0, *, share: float = 0.5, rings: int = 48, segments: int = 96) -> Mesh:
    """The lowest ``share`` of a sphere around the origin, seen from inside; its UV are an area-preserving disk."""
    height = np.linspace(0, share, rings + 1)  # of a ring's rim, in diameters above the lowest point
    angle = np.arange(segments) * (2 * math.pi / segments)
    z = -1 + 2 * height[1:, None] + np.zeros(segments)
    across = np.sqrt(1 - z * z)
    normals = -np.stack([across * np.cos(angle), across * np.sin(angle), z], -1).reshape(-1, 3)
    disk = np.sqrt(height[1:, None] / share) * np.ones(segments)
    uv = 0.5 + 0.48 * np.stack([disk * np.cos(angle), disk * np.sin(angle)], -1).reshape(-1, 2)
    normals, uv = np.vstack([normals, [(0, 0, 1)]]), np.vstack([uv, [(0.5, 0.5)]])
    lowest, faces = rings * segments, []
    for i in range(segments):
        j = (i + 1) % segments
        faces.append((lowest, i, j))
        for ring in range(rings - 1):
            a, b = ring * segments, (ring + 1) * segments
            faces += [(a + i, b + i, b + j), (a + i, b + j, a + j)]
    return mesh_of(-radius * normals, np.array(faces), normals=normals, uv=uv)
