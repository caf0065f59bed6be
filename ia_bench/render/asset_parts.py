"""Materials and triangles of glTF (.glb, .gltf) and of OBJ with MTL, part by part; :mod:`ia_bench.render.asset_files` joins them.

Values are those of the files, to rounding: base colour is decoded from sRGB texel by texel (OpenEXR is linear), roughness and
metallic are linear, and in glTF each is its factor times its texture.

What an OBJ says of a material: ``map_Kd`` or ``Kd`` (albedo), ``map_Pr`` or ``Pr`` (roughness), ``map_Pm`` or ``Pm`` (metallic); a
map replaces the number. Where the material has a line ``bsdf``, as nvdiffrec writes it, ``map_Ks`` holds roughness in green and
metallic in blue. Else, without a roughness, the Phong exponent ``Ns`` stands for one: roughness^4 = alpha^2 = 2 / (Ns + 2)
(Walter et al. 2007, section 5.2).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, is_file, shown
from ia_bench.geometry.mesh_files import (
    expect_plain_gltf,
    faces_by_material,
    gltf_header,
    named_by_gltf,
    obj_text,
    of_the_standard,
    parsed_by_trimesh,
    placed_parts,
    stored_normals,
    wound,
)
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import expect_size_to_read, read_exr
from ia_bench.scenes.photograph import picture_values, read_values

Note = Callable[[str], None]
Parts = tuple[list["Part"], dict[str, "Surface"]]
OUTSIDE = 1e-5  # by which texture coordinates may pass [0, 1]


@dataclass(frozen=True)
class Surface:
    """One material: linear maps, (1, 1) where it is a number; None where the file says nothing."""

    albedo: np.ndarray
    roughness: np.ndarray | None = None
    metallic: np.ndarray | None = None

    @property
    def maps(self) -> dict[str, np.ndarray]:
        """The maps that there are, by name."""
        return {name: image for name, image in vars(self).items() if image is not None}


@dataclass(frozen=True)
class Part:
    """Triangles of one material, in the axes of the file; ``material`` names it. Its albedo is multiplied by ``colours`` (V, 3)."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None
    material: str
    colours: np.ndarray | None = None


def read_parts(path: Path, note: Note) -> Parts:
    """The parts of a file, and its materials by name. Raises InputError; ``note`` takes one line for each thing left out."""
    if not is_file(path):
        raise InputError(f"{shown(path)}: no such mesh")
    kind = path.suffix.lower()
    if kind not in (".glb", ".gltf", ".obj"):
        raise InputError(f"{path}: expected a mesh with textures (.glb, .gltf or .obj), found {kind or 'no suffix'}")
    if kind == ".obj":
        return _obj(path, note)
    with of_the_standard(path):
        return _gltf(path, note)


def asset_files(path: Path) -> list[Path]:
    """The file and those that it names: materials, textures and buffers; of a file that cannot be read, it alone."""
    try:
        if path.suffix.lower() == ".obj":
            materials = _material_file(path)
            values = _mtl(materials).values() if materials else ()
            names = {_texture_of(line)[0] for lines in values for key, line in lines.items() if key.startswith("map_")}
            beside = [materials.parent / name for name in names] if materials else []
            return [path, *([materials] if materials else []), *sorted(file for file in beside if file.is_file())]
    except (InputError, OSError, TypeError, AttributeError, ValueError):  # told when it is read
        return [path]
    return [path, *named_by_gltf(path, "buffers", "images")]


# ---- glTF 2.0 ------------------------------------------------------------------------------------------------------
IGNORED = {"normalTexture": "a normal map", "emissiveTexture": "light of its own", "occlusionTexture": "an occlusion map"}
OTHER_MODEL = "KHR_materials_pbrSpecularGlossiness"
METALLIC = {"metallicFactor", "metallicRoughnessTexture"}
REPEAT, NEAREST = 10497, 9728  # as the specification numbers them


def _gltf(path: Path, note: Note) -> Parts:
    """Parts and materials of a glTF file; trimesh reads geometry and pictures, factors are taken from the file, unrounded."""
    header = gltf_header(path)
    expect_plain_gltf(path, header)
    materials = header.setdefault("materials", [])
    used = {IGNORED[key] for material in materials for key in IGNORED if key in material}
    used |= {"transparency" for material in materials if material.get("alphaMode", "OPAQUE") != "OPAQUE"}
    used |= {"light of its own" for material in materials if any(material.get("emissiveFactor", ()))}
    if any(sampler.get("magFilter") == NEAREST for sampler in header.get("samplers", [])):
        note(f"{path.name}: textures are looked up bilinearly, not by the filter NEAREST")
    used |= {extension for material in materials for extension in material.get("extensions", ())}
    for number, material in enumerate(materials):  # so that trimesh says which one it means
        material["name"], material["_name"] = str(number), material.get("name") or f"material {number}"
        if "pbrMetallicRoughness" in material:  # or trimesh would take the other model's textures
            material.get("extensions", {}).pop(OTHER_MODEL, None)
    for primitive in (one for mesh in header.get("meshes", []) for one in mesh.get("primitives", [])):
        primitive.setdefault("material", len(materials))  # of its own where there is none: trimesh would round its colours
    materials.append({"name": str(len(materials)), "_name": ""})
    parts, surfaces = [], dict[str, Surface]()
    metals = [one for one in materials[:-1] if not METALLIC & one.get("pbrMetallicRoughness", {}).keys()]
    if metals:
        names = ", ".join(shown(one["_name"]) for one in metals)
        note(f"{path.name}: no metallicFactor of {names}, which in glTF is metal: 0 says that it is none")
    if used:
        note(f"{path.name}: {', '.join(sorted(used))} left out: materials here have base colour, roughness and metallic")
    for mesh, matrix, normals in placed_parts(parsed_by_trimesh(path, header)):
        material = getattr(mesh.visual, "material", None)
        number = int(getattr(material, "name", len(materials) - 1))
        plain, said = f"material {number}", shown(materials[number]["_name"])
        name = (said if said in ("", plain) else f"{plain} ({said})") or "what has no material"
        if name not in surfaces:
            pictures = getattr(material, "baseColorTexture", None), getattr(material, "metallicRoughnessTexture", None)
            surfaces[name] = _gltf_surface(path, f"{path}: {name}", materials[number], *pictures)
        uv, colours = getattr(mesh.visual, "uv", None), getattr(mesh.visual, "vertex_attributes", {}).get("color")
        if colours is not None:  # linear, as glTF has them, whatever their type
            colours = np.asarray(colours, np.float32)[:, :3] / (np.iinfo(colours.dtype).max if colours.dtype.kind == "u" else 1)
            if (wrong := colours[~((colours >= 0) & np.isfinite(colours))]).size:
                raise InputError(f"{path}: {name}: expected colours of vertices of 0 and more, found {wrong[0]:.4g}")
            colours = None if (colours == 1).all() else colours  # white changes nothing
        if uv is not None and np.floor(uv.min(0) + OUTSIDE).any() and not _repeats(header, number):
            raise InputError(f"{path}: {name}: expected textures that repeat, or coordinates within 0 ... 1, found neither")
        vertices = np.asarray(mesh.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
        parts.append(Part(vertices, wound(mesh.faces, matrix), normals, uv, name, colours))
    return parts, surfaces


def _repeats(header: Mapping[str, Any], number: int) -> bool:
    """Whether the textures of a material repeat beyond their edges, as they do unless a sampler says something else."""
    said = header["materials"][number].get("pbrMetallicRoughness", {})
    textures = [header["textures"][said[key]["index"]] for key in ("baseColorTexture", "metallicRoughnessTexture") if key in said]
    samplers = [header["samplers"][texture["sampler"]] for texture in textures if "sampler" in texture]
    return all(sampler.get(key, REPEAT) == REPEAT for sampler in samplers for key in ("wrapS", "wrapT"))


def _gltf_surface(path: Path, where: str, material: Mapping[str, Any], base: Any, packed: Any) -> Surface:  # noqa: ANN401
    """One material, from its pictures as trimesh has them; raises InputError, which says ``where``, for what is not done here."""
    if not material["_name"]:  # colours of vertices alone
        return Surface(np.ones((1, 1, 3), np.float32))
    found = material.get("pbrMetallicRoughness", {})
    for key, picture in (("baseColorTexture", base), ("metallicRoughnessTexture", packed)):
        said = found.get(key)
        if said is None:
            continue
        if said.get("texCoord", 0) != 0 or "KHR_texture_transform" in said.get("extensions", {}):
            raise InputError(
                f"{where}: {key}: expected the first texture coordinates as they are, found others or a transform of them"
            )
        if picture is None:
            raise InputError(f"{where}: {key}: expected a picture (PNG, JPEG), found none that can be read")
    if "pbrMetallicRoughness" not in material and OTHER_MODEL in material.get("extensions", {}):
        raise InputError(f"{where}: expected the metallic-roughness model, found specular-glossiness")
    pictures = [None if one is None else _picture(path, one) for one in (base, packed)]
    return _surface_of(found, *pictures)


def _surface_of(factors: Mapping[str, Any], base: np.ndarray | None, packed: np.ndarray | None) -> Surface:
    """Factor times texture (glTF 2.0, section 3.9.2); ``base`` and ``packed`` (H, W, 4) as stored."""
    colour = np.asarray(factors.get("baseColorFactor", [1.0] * 4), np.float32)[:3]
    ones = np.ones((1, 1, 4), np.float32)
    roughness, metallic = (np.float32(factors.get(f"{name}Factor", 1.0)) for name in ("roughness", "metallic"))
    albedo = colour * (ones[..., :3] if base is None else srgb_to_linear(base[..., :3]))
    packed = ones if packed is None else packed
    return Surface(albedo, roughness * packed[..., 1], metallic * packed[..., 2] if metallic > 0 else None)


def _picture(path: Path, picture: Image.Image) -> np.ndarray:
    expect_size_to_read(path, *picture.size)
    try:
        return picture_values(path, picture)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: expected pictures that can be read, found one that cannot ({error})") from None


# ---- OBJ with MTL --------------------------------------------------------------------------------------------------


def _obj(path: Path, note: Note) -> Parts:
    """Parts and materials of an OBJ file; trimesh reads the geometry."""
    loaded: Any = parsed_by_trimesh(path)
    materials = _material_file(path)
    if materials is None:
        raise InputError(f"{path}: expected mtllib FILE.mtl, which says where the textures are, found none")
    said, text = _mtl(materials), obj_text(path)
    if (lacking := next((name for name in faces_by_material(text) if name and name not in said), None)) is not None:
        raise InputError(f"{path}: usemtl {shown(lacking)}: expected a material of {materials.name}, found none of that name")
    if re.search(r"^v([ \t]+\S+){6}", text, re.MULTILINE):
        note(f"{path.name}: colours of vertices are left out: in OBJ nobody says how they are encoded; glTF has them")
    meshes = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    parts, surfaces = [], dict[str, Surface]()
    for mesh in (one for one in meshes if hasattr(one, "faces")):
        name = getattr(getattr(mesh.visual, "material", None), "name", None)
        if name not in said:
            if len(said) != 1:
                raise InputError(f"{path}: expected usemtl before every face, with a material of {materials.name}, found none")
            (name,) = said
        if name not in surfaces:
            surfaces[name] = _mtl_surface(materials, name, said[name], note)
        uv = getattr(mesh.visual, "uv", None)
        parts.append(Part(np.asarray(mesh.vertices), np.asarray(mesh.faces), stored_normals(mesh), uv, name))
    return parts, surfaces


def _material_file(path: Path) -> Path | None:
    """The file that ``mtllib`` names; None without such a line. Raises InputError where it is not there."""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        name = next((line.strip()[6:].strip() for line in lines if line.split(maxsplit=1)[:1] == ["mtllib"]), None)
    return None if name is None else file_below(path.parent, name, f"{path}: mtllib")


def _mtl(path: Path) -> dict[str, dict[str, str]]:
    """Material -> key, in lower case -> the rest of its line."""
    found: dict[str, dict[str, str]] = {}
    lines: dict[str, str] = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, rest = line.strip().replace("\t", " ").partition(" ")
        if key == "newmtl":
            lines = found.setdefault(" ".join(rest.split()), {})
        elif key and not key.startswith("#"):
            lines[key.lower()] = rest.strip()
    if not found:
        raise InputError(f"{path}: expected newmtl NAME, found none")
    return found


NOTHING = {"d": 1, "tr": 0, "ke": 0}
"""Numbers that say that there is nothing to leave out."""


def _mtl_surface(path: Path, name: str, said: Mapping[str, str], note: Note) -> Surface:
    where = f"{path}: {name}"

    def number(key: str, count: int = 1) -> np.ndarray | None:
        """One texel of ``count`` channels."""
        if key not in said:
            return None
        try:
            values = np.array([float(word) for word in said[key].split()], np.float32)[:count]
        except ValueError:
            values = np.zeros(0, np.float32)
        if len(values) != count or not (values >= 0).all() or not np.isfinite(values).all():
            raise InputError(f"{where}: {key.capitalize()}: expected {count} number(s) >= 0, found {shown(repr(said[key]))}")
        return values.reshape(1, 1, count)

    def image(key: str, *, srgb: bool = False) -> np.ndarray | None:
        if key not in said:
            return None
        line = f"{where}: map_{key[4:].capitalize()}"
        name, changed = _texture_of(said[key])
        if changed:
            expected = "expected the texture as it is, where its coordinates are"
            raise InputError(f"{line}: {expected}, found one that is moved or of other values: {shown(said[key])}")
        file = file_below(path.parent, name, line)
        if file.suffix.lower() == ".exr":
            stored = read_exr(file, None, grey=True)[..., :3]
            return np.broadcast_to(stored, (*stored.shape[:2], 3))
        stored = read_values(file)[..., :3]
        return srgb_to_linear(stored) if srgb else stored

    def first(*maps: np.ndarray | None) -> np.ndarray | None:
        """The first channel of the first that there is."""
        return next((one[..., 0] for one in maps if one is not None), None)

    colour, painted = number("kd", 3), image("map_kd", srgb=True)
    albedo = colour if painted is None else painted
    if albedo is None:
        raise InputError(f"{where}: expected an albedo, map_Kd or Kd, found neither")
    if painted is not None and colour is not None and (colour != 1).any():
        note(f"{where}: map_Kd is taken for the albedo as it is, and Kd {said['kd']} beside it left out")
    ignored = {"norm": "normal map", "bump": "normal or bump map", "map_bump": "normal or bump map"}
    ignored |= {"map_d": "transparency", "d" if "d" in said else "tr": "transparency"}  # some write Tr as d
    for key, what in (ignored | {"map_ke": "light of its own", "ke": "light of its own"}).items():
        if key in said and not all(_is_number(word) and float(word) == NOTHING.get(key) for word in said[key].split()):
            note(f"{where}: its {what} ({key}) is left out: materials here have albedo, roughness and metallic")
    packed = image("map_ks") if "bsdf" in said else None
    green, blue = (None, None) if packed is None else (packed[..., 1:], packed[..., 2:])
    roughness, metallic = first(image("map_pr"), green, number("pr")), first(image("map_pm"), blue, number("pm"))
    exponent = first(number("ns"))
    if roughness is None and exponent is not None and exponent[0, 0] > 0:
        roughness = ((2 / (exponent + 2)) ** 0.25).astype(np.float32)
        note(f"{where}: roughness {float(roughness[0, 0]):.3f} from Ns {said['ns']}: roughness^4 = 2 / (Ns + 2)")
    return Surface(albedo, roughness, metallic)


UNCHANGED: dict[str, tuple[int, ...]] = {"-mm": (0, 1), "-o": (0, 0, 0), "-s": (1, 1, 1), "-t": (0, 0, 0)}
"""Options of maps with several numbers, and those that change nothing."""


def _texture_of(line: str) -> tuple[str, bool]:
    """The file of a map's line, and whether options move the texture or change its values."""
    words, changed = line.split(), False
    while words and words[0].startswith("-"):
        option = words.pop(0)
        stays = UNCHANGED.get(option, ())
        values = words[: len(stays) or 1]
        while stays and values and not _is_number(values[-1]):  # the last ones may be left out
            values.pop()
        changed |= any(float(value) != stay for value, stay in zip(values, stays, strict=False))
        changed |= option == "-imfchan" and values != ["r"]
        words = words[len(values) :]
    return " ".join(words).replace("\\", "/"), changed


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
