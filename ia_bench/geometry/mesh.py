"""Reading a triangle mesh: repaired with a line that says so, or refused with one clear error."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from ia_bench.common.cache import Cache, content_key
from ia_bench.common.errors import InputError
from ia_bench.common.files import hash_of_files, is_file
from ia_bench.geometry.mesh_files import (
    expect_plain_gltf,
    gltf_header,
    joined_normals,
    of_the_standard,
    parsed_by_trimesh,
    placed_parts,
    ply_header,
    stored_normals,
    wound,
)
from ia_bench.geometry.unwrapping import unwrap
from ia_bench.scenes.scene import Mesh

if TYPE_CHECKING:
    import trimesh

READ = "8"  # part of a kept mesh's key; raised whenever another mesh is made of the same file
MADE_BY = ("trimesh", "xatlas")  # another version of these may make another mesh
FLAT = 1e-6  # share of the cube around it that a closed part encloses at least: less is a sheet with two sides, and rounding
FAR = 1e4  # sizes of an object from the origin: single precision, in which rays are traced, shifts its points by .0006 of it there
BORDER = 1 / 256  # of the whole square, around what each material has: look-ups between texels reach beyond it


def load_mesh(path: Path, *, uv: str = "mesh") -> tuple[Mesh, tuple[str, ...]]:
    """Read ``path`` (PLY, OBJ, glTF: whatever trimesh reads) and return the mesh and one note per repair.

    ``uv``: "mesh" uses the file's texture coordinates, "xatlas" makes new ones.

    A PLY file, which refers to no other, is kept in the cache as it was found: that is half a second sooner than trimesh itself.
    Triangles end up counter-clockwise from outside.

    Raises InputError for a file without triangles, with NaN or Inf vertices, or (with "mesh") without UV, or UV outside [0, 1].
    """
    if path.suffix.lower() != ".ply" or not is_file(path):
        return _read_mesh(path, uv)
    cache, key = Cache(), content_key("mesh", READ, uv, *map(version, MADE_BY), hash_of_files(path.parent, [path]))
    found = cache.get(key)
    if found is not None:
        tensors, about = found
        return Mesh(**{name: tensor.numpy() for name, tensor in tensors.items()}), tuple(about["notes"])
    mesh, notes = _read_mesh(path, uv)
    cache.put(key, {name: torch.from_numpy(array) for name, array in vars(mesh).items()}, {"notes": notes})
    return mesh, notes


def _read_mesh(path: Path, uv: str) -> tuple[Mesh, tuple[str, ...]]:
    import trimesh

    header = gltf_header(path) if path.suffix.lower() in (".glb", ".gltf") and is_file(path) else None
    loaded = parsed_by_trimesh(path, header)
    if header is not None:
        with of_the_standard(path):
            expect_plain_gltf(path, header, uv=uv == "mesh")
    textures = len(re.findall(rb"^comment TextureFile\b", ply_header(path), re.MULTILINE))
    if uv == "mesh" and textures > 1:  # whose coordinates lie over each other, and trimesh does not tell which face has which
        raise InputError(f"{path}: expected UV for one texture, found those for {textures}; run with reader.options.uv=xatlas")
    placed = placed_parts(loaded) if isinstance(loaded, trimesh.Scene) else []  # a file of several parts, or a glTF
    if isinstance(loaded, trimesh.Trimesh):
        placed = [(loaded, np.eye(4), stored_normals(loaded))]
    placed = [part for part in placed if len(part[0].faces)]
    if not placed:
        raise InputError(f"{path}: expected triangles, found none")
    counts = [len(part.vertices) for part, _, _ in placed]
    vertices = np.concatenate([
        np.asarray(part.vertices) if (matrix == np.eye(4)).all() else trimesh.transform_points(part.vertices, matrix)
        for part, matrix, _ in placed
    ])  # fmt: skip
    firsts = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([wound(part.faces, matrix) + first for (part, matrix, _), first in zip(placed, firsts, strict=True)])
    stored = joined_normals(counts, [normals for _, _, normals in placed])
    texture_uv, materials = _joined_uv([part for part, _, _ in placed], path)
    turned = 0
    if stored is None and np.isfinite(vertices).all() and faces.max() < len(vertices):  # stored normals know what is outside
        faces, turned = _consistently_wound(vertices, faces)
    mesh, notes = sound_mesh(path, vertices, faces, stored, texture_uv, uv=uv)
    if turned:
        notes = (*notes, f"{path.name}: {turned} triangles wound against their neighbours, turned round")
    if materials > 1 and uv == "mesh":
        notes = (*notes, f"{path.name}: texture coordinates of {materials} materials are laid side by side")
    return _wound_outward(mesh, path, notes)


def _consistently_wound(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """The faces, neighbours wound alike, and how many were turned for it: normals are computed of them."""
    import trimesh

    places, shared = np.unique(vertices, axis=0, return_inverse=True)
    solid = trimesh.Trimesh(places, shared[faces], process=False)
    if solid.is_winding_consistent:
        return faces, 0
    trimesh.repair.fix_winding(solid)
    turned = (solid.faces != shared[faces]).any(1)
    return np.where(turned[:, None], faces[:, ::-1], faces), int(turned.sum())


def _joined_uv(parts: Sequence[trimesh.Trimesh], path: Path) -> tuple[np.ndarray | None, int]:
    """The texture coordinates of all parts in one square, and of how many materials; None where a part has none.

    Each material has coordinates of its own, so those of several lie side by side, in rectangles of one size whatever its texture:
    here textures are recovered, and none is read. Coordinates beyond [0, 1] are for :func:`sound_mesh` to refuse.
    """
    found = [(np.asarray(uv, np.float64), part) for part in parts if (uv := getattr(part.visual, "uv", None)) is not None]
    given = [uv for uv, part in found if len(uv) == len(part.vertices)]
    if len(given) < len(parts):
        return None, 0
    materials = [getattr(part.visual, "material", None) for part in parts]
    keys = [id(material) for material in materials]  # of a glTF, one object for each of its materials, named or not
    if path.suffix.lower() == ".obj":  # of which trimesh makes a part for each material, and drops its name if there is no MTL
        keys = list(range(len(parts)))
    places = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    if len(places) == 1 or not all(((uv >= -1e-6) & (uv <= 1 + 1e-6)).all() for uv in given):
        return np.concatenate(given), 1
    columns = math.ceil(math.sqrt(len(places)))
    rows = math.ceil(len(places) / columns)
    corners, size = [np.array(divmod(places[key], columns)[::-1]) for key in keys], 1 / np.array([columns, rows])
    border = np.minimum(BORDER, 0.25 * size)
    laid = [corner * size + border + (size - 2 * border) * uv for corner, uv in zip(corners, given, strict=True)]
    return np.concatenate(laid), len(places)


def _wound_outward(mesh: Mesh, path: Path, notes: tuple[str, ...]) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh with its triangles counter-clockwise from outside: as most normals say, and so that closed parts have a volume."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if (across * mesh.normals[mesh.faces].sum(1)).sum() < 0:
        mesh = replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
        notes = (*notes, f"{path.name}: triangles wound against the stored normals; all of them turned round")
    turned, parts = _inside_out(mesh)
    if turned.any():
        faces, normals = mesh.faces.copy(), mesh.normals.copy()
        faces[turned] = faces[turned, ::-1]
        normals[np.unique(mesh.faces[turned])] *= -1
        mesh = replace(mesh, faces=faces, normals=normals)
        what = "a closed mesh that is" if turned.all() else f"closed parts ({parts}) that are"
        notes = (*notes, f"{path.name}: {what} inside out; triangles and normals turned round")
    return mesh, notes


def _inside_out(mesh: Mesh) -> tuple[np.ndarray, int]:
    """Which triangles (F,) bound closed parts that are inside out, and how many such parts; a hollow in another part is none."""
    import trimesh

    places, shared = np.unique(mesh.vertices, axis=0, return_inverse=True)
    solid = trimesh.Trimesh(places, shared[mesh.faces], process=False)
    part = trimesh.graph.connected_component_labels(solid.face_adjacency, node_count=len(solid.faces))
    corners = solid.triangles - solid.triangles[:1, :1]  # near the origin, for the sake of rounding
    volume = np.bincount(part, (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum(1))
    sides = np.bincount(solid.edges_unique_inverse)[solid.edges_unique_inverse].reshape(-1, 3)  # triangles that share each edge
    open_parts = np.bincount(part, (sides != 2).any(1)) > 0
    low, high = np.full((len(volume), 3), np.inf), np.full((len(volume), 3), -np.inf)
    np.minimum.at(low, part, corners.min(1))
    np.maximum.at(high, part, corners.max(1))
    closed = np.flatnonzero((volume < -FLAT * (high - low).max(1) ** 3) & ~open_parts)
    wrong = [one for one in closed if not ((low < low[one]) & (high > high[one])).all(1).any()]
    return np.isin(part, wrong), len(wrong)


def sound_mesh(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    stored: np.ndarray | None,
    texture_uv: np.ndarray | None,
    *,
    uv: str = "mesh",
) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh of vertices (V, 3), faces (F, 3), ``stored`` normals (V, 3) and ``texture_uv`` (V, 2); see :func:`load_mesh`.

    ``path`` names it in messages. None stands for what the file does not have.
    """
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise InputError(f"{path}: expected vertices and faces of three numbers each, found {vertices.shape} and {faces.shape}")
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices).all(axis=1)).sum())
        raise InputError(f"{path}: {bad} of {len(vertices)} vertices are NaN or Inf")
    if faces.min() < 0 or faces.max() >= len(vertices):
        found = f"{faces.min()} to {faces.max()}"
        raise InputError(f"{path}: expected faces of vertices 0 to {len(vertices) - 1}, found {found}")
    if texture_uv is not None and len(texture_uv) != len(vertices):
        raise InputError(f"{path}: expected one UV per vertex ({len(vertices)}), found {len(texture_uv)}")
    notes: list[str] = []
    faces = _without_degenerate(vertices, faces, path, notes)
    normals = _normals(vertices, faces, stored, path, notes)
    used, compact = np.unique(faces, return_inverse=True)
    if len(used) < len(vertices):
        notes.append(f"{path.name}: dropped {len(vertices) - len(used)} unreferenced vertices of {len(vertices)}")
    vertices, normals, faces = vertices[used], normals[used], compact.reshape(faces.shape)
    expect_near_origin(str(path), vertices.min(0), vertices.max(0))
    if uv == "xatlas":
        try:
            return unwrap(vertices, faces, normals), (*notes, f"{path.name}: UV made by xatlas")
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if texture_uv is None:
        raise InputError(f"{path}: the mesh has no UV (or a glTF no material); add it, or run with reader.options.uv=xatlas")
    given = np.asarray(texture_uv, np.float64)[used]
    if not (given.min() >= -1e-6 and given.max() <= 1 + 1e-6):
        found = f"{given.min():.7g} ... {given.max():.7g}"
        raise InputError(f"{path}: expected UV within [0, 1], found {found}; run with reader.options.uv=xatlas")
    parts = vertices.astype(np.float32), faces.astype(np.int32), normals.astype(np.float32), given.clip(0, 1).astype(np.float32)
    return Mesh(*parts), tuple(notes)


def expect_near_origin(what: str, low: np.ndarray, high: np.ndarray) -> None:
    """Raise InputError for an object between two corners (3,) that is too far from the origin for its size."""
    distance, size = (float(np.linalg.norm(part)) for part in (0.5 * (low + high), high - low))
    if distance > FAR * size:
        raise InputError(
            f"{what}: expected an object at most {FAR:g} times its size from the origin, found one of size {size:.3g} at distance "
            f"{distance:.3g}; move cameras and mesh to the origin, since numbers of single precision do not tell its points apart"
        )


def _without_degenerate(vertices: np.ndarray, faces: np.ndarray, path: Path, notes: list[str]) -> np.ndarray:
    sound = with_area(vertices, faces)
    if not sound.any():
        raise InputError(f"{path}: every one of the {len(faces)} triangles has zero area")
    if not sound.all():
        notes.append(f"{path.name}: dropped {int((~sound).sum())} zero-area triangles of {len(faces)}")
    return faces[sound]


def with_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which triangles (F,) are more than a line or a point."""
    corners = vertices[faces]
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled_area = np.linalg.norm(np.cross(*edges), axis=1)
    longest = np.maximum(np.linalg.norm(edges[0], axis=1), np.linalg.norm(edges[1], axis=1))
    found: np.ndarray = doubled_area > 1e-10 * longest**2  # relative, so that the scale of the scene does not matter
    return found


def _normals(vertices: np.ndarray, faces: np.ndarray, stored: np.ndarray | None, path: Path, notes: list[str]) -> np.ndarray:
    if stored is not None and len(stored) == len(vertices):
        length = np.linalg.norm(stored, axis=1, keepdims=True)
        used = length[np.unique(faces)]  # others go
        if np.isfinite(used).all() and (used > 1e-6).all():
            return np.asarray(stored) / np.maximum(length, 1e-12)
        notes.append(f"{path.name}: stored normals are zero or not finite in places; smooth normals computed instead")
    else:
        notes.append(f"{path.name}: no normals stored; smooth normals computed")
    return smooth_normals(vertices, faces)


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3): the mean of those of the triangles around a vertex, weighted by their angles there.

    Vertices in one place, as on a seam, share it. Where it is 0, as on both sides of a leaf, each has that of one of its triangles.
    """
    import trimesh

    places, shared = np.unique(vertices, axis=0, return_inverse=True)
    extent = np.ptp(vertices[faces], axis=(0, 1)).max()
    unit = 2.0 ** -np.round(np.log2(extent)) if extent > 0 else 1.0  # trimesh takes small triangles for none
    normals = np.asarray(trimesh.Trimesh(unit * places, shared[faces], process=False).vertex_normals)[shared]
    flat = np.linalg.norm(normals, axis=1) < 1e-6
    if flat[faces].any():
        face_normals = np.cross(*(unit * (vertices[faces[:, i]] - vertices[faces[:, 0]]) for i in (1, 2)))
        normals = normals.copy()
        for corner in range(3):
            where = flat[faces[:, corner]]
            normals[faces[where, corner]] = face_normals[where]
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return normals
