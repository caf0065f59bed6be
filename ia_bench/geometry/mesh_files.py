"""What trimesh makes of a mesh's file: its parts as they are stored and placed, and what it would leave out without a word."""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json, shown

if TYPE_CHECKING:
    import trimesh

EXTENSIONS = ("KHR_materials_", "KHR_texture_transform", "EXT_texture_webp")
"""How extensions begin that a glTF may require: they are of materials alone, which are no part of a mesh."""
TRIANGLES, STRIP, FAN, FLOAT = 4, 5, 6, 5126  # as the specification of glTF numbers them
INSTANCES = "EXT_mesh_gpu_instancing"


def parsed_by_trimesh(path: Path, header: dict[str, Any] | None = None) -> Any:  # noqa: ANN401 (a trimesh.Trimesh or Scene)
    """What trimesh makes of a file: parts, materials and places as they are stored. ``header``: the JSON that a glTF is to have.

    Raises InputError for what is no readable mesh.
    """
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such mesh")
    import trimesh

    class Beside(trimesh.resolvers.FilePathResolver):
        """What the file refers to, such as materials: files alone, since a pipe could be waited for without an end."""

        def absolute(self, name: str) -> Path:
            found = Path(super().absolute(name if header is None else unquote(name)))  # glTF has URIs
            if found.exists() and not found.is_file():
                raise InputError(f"{shown(found)}: expected a file, found none")
            return found

        def get(self, name: str) -> bytes:
            """What a file holds; trimesh would also take one of that name in another folder, which no run knows as its own."""
            return self.absolute(name).read_bytes()

    kind = path.suffix.lower().removeprefix(".")
    text = obj_text(path) if kind == "obj" else ""
    if re.search(r"^f\b[^\n]*[\s/]0+(?![0-9])", text, re.MULTILINE):
        raise InputError(f"{path}: expected faces of vertices that are counted from 1, found vertex 0")
    relative = re.search(r"^f\b[^\n]*[\s/]-", text, re.MULTILINE)
    if relative and "\nv" in text[relative.end() :]:  # trimesh counts them from the end of the file
        raise InputError(f"{path}: expected faces that count vertices backwards after all vertices, found vertices after them")
    for name, faces in faces_by_material(text).items():  # of each trimesh looks at the first face alone
        if all(re.search(rf"^f -?\d+{kinds}-?\d+\s", faces, re.MULTILINE) for kinds in ("/", "//")):
            said = f" of usemtl {shown(name)}" if name else ""
            raise InputError(f"{path}: expected texture coordinates in all faces{said} or in none, found v/vt beside v//vn")
    # Vertices are split by UV only where a PLY has those of faces: else trimesh would drop vertices, and all stored normals.
    options: Any = {"process": False, "fix_texture": b" texcoord" in ply_header(path), "resolver": Beside(str(path))}
    logger, was = trimesh.util.log, trimesh.util.log.disabled
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy and Pillow: what is wrong with a file is said in a sentence of ours
            logger.disabled = True  # and a texture that is not there, of which it would print a traceback, is no part of a mesh
            content = text.encode() if header is None else _gltf_for_trimesh(path, header)
            loaded: Any = trimesh.load(io.BytesIO(content) if content else path, file_type=kind, **options)
            # Of split vertices trimesh keeps no normals, or those of others where there are as many.
            if options["fix_texture"] and hasattr(loaded, "faces"):
                whole: Any = trimesh.load(path, file_type=kind, **options | {"fix_texture": False})
                if (stored := stored_normals(whole)) is not None:
                    normals = np.zeros(loaded.vertices.shape)
                    normals[loaded.faces] = stored[whole.faces]
                    loaded.vertex_normals = normals
            return loaded
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise InputError(f"{path}: not a readable mesh ({type(error).__name__}: {error})") from None
    finally:
        logger.disabled = was


def obj_text(path: Path) -> str:
    """The text of an OBJ file without comments, where each key begins its line and has a blank behind it.

    trimesh leaves out faces that are indented or have a tab there, and takes commented materials for used ones.
    """
    text = re.sub(r"^[ \t]*#.*$", "", path.read_text(encoding="utf-8-sig", errors="replace"), flags=re.MULTILINE)
    text = re.sub(r"^[ \t]*(v[tn]?|f|usemtl|mtllib)[ \t]+", r"\1 ", text.replace("\\\n", " "), flags=re.MULTILINE)
    return re.sub(r"^((?:v[tn]?|f) [^#\n]*)#.*$", r"\1", text, flags=re.MULTILINE)


def faces_by_material(text: str) -> dict[str, str]:
    """The lines of faces (``f``) of an :func:`obj_text` by the material of their ``usemtl``, "" before the first; all have some."""
    found, name = dict[str, list[str]](), ""
    for line in text.splitlines():
        if line.startswith("usemtl "):
            name = " ".join(line.split()[1:])
        elif line.startswith("f "):
            found.setdefault(name, []).append(f"{line}\n")
    return {name: "".join(lines) for name, lines in found.items()}


def gltf_header(path: Path) -> dict[str, Any]:
    """The JSON of a glTF file; the chunks behind it in a .glb are not read. Raises InputError."""
    if path.suffix.lower() == ".gltf":
        return read_json(path)
    try:
        with path.open("rb") as file:
            magic, version, _, size, kind = struct.unpack("<4sIII4s", file.read(20))
            if (magic, version, kind) != (b"glTF", 2, b"JSON"):
                raise ValueError
            header = json.loads(file.read(size))
        if not isinstance(header, dict):
            raise ValueError
    except (struct.error, ValueError, RecursionError):
        raise InputError(f"{path}: expected a binary glTF 2.0 file, found another or a damaged one") from None
    return header


def _gltf_for_trimesh(path: Path, header: dict[str, Any]) -> bytes:
    """The glTF file with another JSON, less cameras and lines: trimesh loses a node that has one, and what hangs below it."""
    for node in header.get("nodes", []):
        node.pop("camera", None)
        drawn = header["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []
        if all(primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP) for primitive in drawn):
            node.pop("mesh", None)
    text = json.dumps(header).encode()
    if path.suffix.lower() == ".gltf":
        return text
    content = path.read_bytes()
    text, rest = text + b" " * (-len(text) % 4), content[20 + struct.unpack_from("<I", content, 12)[0] :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


@contextmanager
def of_the_standard(path: Path) -> Iterator[None]:
    """Raise InputError where what is done with the JSON of a glTF fails on types that the standard does not have there."""
    try:
        yield
    except InputError:
        raise
    except (TypeError, AttributeError, LookupError, ValueError) as error:
        raise InputError(f"{path}: expected glTF 2.0, found what is none ({type(error).__name__}: {error})") from error


def expect_plain_gltf(path: Path, header: Mapping[str, Any], *, uv: bool = True) -> None:
    """Raise InputError for geometry that trimesh leaves out, or takes for something else without a word.

    ``uv``: whether texture coordinates count.
    """
    found = [name for name in header.get("extensionsRequired", []) if not name.startswith(EXTENSIONS)]
    accessors, meshes, nodes = dict(enumerate(header.get("accessors", []))), header.get("meshes", []), header.get("nodes", [])
    found += ["morph targets with weights"] * any(any(one.get("weights", ())) for one in (*meshes, *nodes))
    found += ["a skin"] * any("skin" in node for node in nodes)
    found += [INSTANCES] * any(INSTANCES in node.get("extensions", {}) for node in nodes)
    for primitive in (one for mesh in meshes for one in mesh.get("primitives", [])):
        numbers = {**primitive.get("attributes", {}), "indices": primitive.get("indices")}
        stored = {name: accessors.get(number, {}) for name, number in numbers.items()}
        whole = uv and stored.get("TEXCOORD_0", {}).get("componentType", FLOAT) != FLOAT
        sparse = any("sparse" in accessor for accessor in stored.values())
        found += ["whole numbers for TEXCOORD_0"] * whole + ["sparse accessors"] * sparse
        found += ["triangle fans"] * (primitive.get("mode") == FAN)
    if found:
        expected = "expected triangles with plain coordinates in floating point, as exporters write them at rest and uncompressed"
        raise InputError(f"{path}: {expected}, found {', '.join(dict.fromkeys(found))}")


def named_by_gltf(path: Path, *kinds: str) -> list[Path]:
    """The files beside a glTF that it names as "buffers" or "images"; none of another file, or of one that cannot be read."""
    try:
        header = gltf_header(path) if path.suffix.lower() in (".gltf", ".glb") and path.is_file() else {}
        listed = [one for kind in kinds for one in header.get(kind, [])]
        uris = [str(one.get("uri", "data:")) for one in listed]
        return [file for uri in uris if not uri.startswith("data:") and (file := path.parent / unquote(uri)).is_file()]
    except (InputError, OSError, TypeError, AttributeError, ValueError):  # told when it is read
        return []


def stored_normals(part: trimesh.Trimesh) -> np.ndarray | None:
    """The normals (V, 3) that a file gives its mesh. The public attribute would compute some where there are none."""
    stored: np.ndarray | None = part._cache.cache.get("vertex_normals")
    return stored


def placed_parts(parts: trimesh.Scene) -> list[tuple[trimesh.Trimesh, np.ndarray, np.ndarray | None]]:
    """Every mesh of a file, with the matrix (4, 4) that places it, and its stored normals (V, 3).

    Those are placed, too; None for a part without normals: trimesh itself drops the normals of parts that it moves.
    """
    import trimesh

    found = []
    for node in parts.graph.nodes_geometry:
        matrix, name = parts.graph[node]
        part = parts.geometry[name]
        if isinstance(part, trimesh.Trimesh):  # not points or lines, which are no part of the mesh
            stored = stored_normals(part)
            found.append((part, matrix, None if stored is None else turned_normals(stored, matrix)))
    return found


def wound(faces: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The faces with the order of their corners turned round where a matrix mirrors them."""
    return np.asarray(faces)[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else np.asarray(faces)


def turned_normals(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) where a matrix (4, 4) moves their surface."""
    turned = np.asarray(normals) @ np.linalg.pinv(matrix[:3, :3])
    return turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)


def joined_normals(counts: Sequence[int], normals: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """The normals of parts of so many vertices as one array, NaN for parts that have none, and None if no part has any."""
    if all(stored is None for stored in normals):
        return None
    pairs = zip(counts, normals, strict=True)
    return np.concatenate([np.full((count, 3), np.nan) if stored is None else stored for count, stored in pairs])


def ply_header(path: Path) -> bytes:
    """What a PLY file says of its content; nothing for a file of another format."""
    if path.suffix.lower() != ".ply":
        return b""
    with path.open("rb") as file:
        return file.read(65536).split(b"end_header")[0]
