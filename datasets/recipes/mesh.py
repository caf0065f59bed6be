"""The triangle mesh of a scene as arrays: welding, checks, PLY (numpy only)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MAX_TRIANGLES = 48_000
VERTEX_PROPERTIES = ("x", "y", "z", "nx", "ny", "nz", "u", "v")
FACE = [("count", "u1"), ("index", "<u2", 3)]


@dataclass(frozen=True)
class Mesh:
    """Vertices split at UV seams and sharp edges: positions, normals (V, 3), uv (V, 2) float32; faces (F, 3) int32."""

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    faces: NDArray[np.int32]


def face_normals(positions: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Normals (F, 3) of triangles, twice the area long."""
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def weld(positions: NDArray[np.float32], normals: NDArray[np.float32], uv: NDArray[np.float32]) -> Mesh:
    """One vertex per distinct (position, normal, uv), given per corner: (F, 3, 3), (F, 3, 3), (F, 3, 2)."""
    rows = np.concatenate([positions, normals, uv], axis=-1).reshape(-1, 8).astype(np.float32)
    vertices, inverse = np.unique(np.round(rows, 6), axis=0, return_inverse=True)
    unit = vertices[:, 3:6] / np.linalg.norm(vertices[:, 3:6], axis=1, keepdims=True)
    return Mesh(vertices[:, :3], unit, vertices[:, 6:], inverse.reshape(-1, 3).astype(np.int32))


def check(mesh: Mesh) -> str:
    """One line of statistics.

    Raises:
        ValueError: if the mesh leaves the unit sphere, has too many triangles, values that are not finite, or
            shading normals that turn away from their face.
    """
    radius = float(np.linalg.norm(mesh.positions, axis=1).max())
    if not np.isfinite(mesh.positions).all() or not np.isfinite(mesh.normals).all() or radius > 1.0 + 1e-4:
        raise ValueError(f"the object must fit the unit sphere around the origin, found radius {radius:.4f}")
    if len(mesh.faces) > MAX_TRIANGLES:
        raise ValueError(f"expected at most {MAX_TRIANGLES} triangles, found {len(mesh.faces)}")
    facing = np.einsum("fk,fck->fc", face_normals(mesh.positions, mesh.faces), mesh.normals[mesh.faces]).min(axis=1)
    turned = int((facing <= 0).sum())
    if turned > 0.02 * len(mesh.faces):
        raise ValueError(f"expected shading normals along their faces, found {turned} triangles where one turns away")
    return (
        f"{len(mesh.faces)} triangles, {len(mesh.positions)} vertices, radius {radius:.3f}, "
        f"{turned} triangles with a shading normal that turns away"
    )


def write_ply(path: Path, mesh: Mesh) -> None:
    """Binary little-endian PLY: vertices x y z nx ny nz u v (float32), then triangles (uint16, at most 65536 vertices).

    Raises:
        ValueError: if the mesh has more vertices.
    """
    if len(mesh.positions) > 2**16:
        raise ValueError(f"{path}: expected at most {2**16} vertices, got {len(mesh.positions)}")
    vertex = np.concatenate([mesh.positions, mesh.normals, mesh.uv], axis=1).astype("<f4")
    face = np.empty(len(mesh.faces), dtype=FACE)
    face["count"], face["index"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    header += [f"property float {name}" for name in VERTEX_PROPERTIES]
    header += [f"element face {len(face)}", "property list uchar ushort vertex_indices", "end_header\n"]
    path.write_bytes("\n".join(header).encode() + vertex.tobytes() + face.tobytes())


def read_ply(path: Path) -> Mesh:
    """The mesh of a file that `write_ply` wrote.

    Raises:
        ValueError: if the file's header is another one.
    """
    header, found, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii", "replace").splitlines()
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    properties = tuple(line.split()[-1] for line in lines if line.startswith("property float"))
    if not found or properties != VERTEX_PROPERTIES or "binary_little_endian" not in lines[1] or " ushort " not in lines[-1]:
        expected = f"binary PLY with float {' '.join(VERTEX_PROPERTIES)} and lists of ushort"
        raise ValueError(f"{path}: expected {expected}, got {lines}")
    vertex = np.frombuffer(body, "<f4", 8 * counts["vertex"]).reshape(-1, 8)
    face = np.frombuffer(body, FACE, counts["face"], 32 * counts["vertex"])
    return Mesh(vertex[:, :3], vertex[:, 3:6], vertex[:, 6:], face["index"].astype(np.int32))
