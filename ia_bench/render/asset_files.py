"""Textured meshes of other programs, glTF (.glb, .gltf) and OBJ with MTL, read as :class:`Assets`; and ``asset.glb``, written.

What the formats say, and how their values are taken: :mod:`ia_bench.render.asset_parts`. One material keeps its textures and its
texture coordinates. Of several, the textures are laid side by side into one square, each with a border of one texel that repeats
its edge, and coordinates follow. Where nobody knows the roughness, renders take ROUGHNESS, and it is not scored.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import smooth_normals, sound_mesh, with_area
from ia_bench.geometry.mesh_files import joined_normals, turned_normals, wound
from ia_bench.geometry.unwrapping import unwrap
from ia_bench.light.environment import turned
from ia_bench.material.textures import fetch
from ia_bench.render.asset_parts import OUTSIDE, Note, Part, Surface, read_parts
from ia_bench.render.indirect import Atlas
from ia_bench.render.reconstruction import Assets
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import read_light
from ia_bench.scenes.scene import FROM_Y_UP, Mesh

Up = Literal["y", "z"]
TO_Z_UP: dict[Up, np.ndarray] = {"z": np.eye(4), "y": FROM_Y_UP}
"""By the axis of a file that points up: what turns it into ours, a rotation about +x."""
ROUGHNESS = 0.5
"""What renders take where nobody knows the roughness."""
LARGEST_SIDE = 8192  # texels of what several textures make
BAKED = 1024  # texels along a side of a texture that is made of the colours of vertices
ROUNDING = 0.01  # by which lossy maps may pass the ends of their range
OVERLAP = 0.1  # of the area in texture coordinates, from which on it is told
PART = 8  # of the largest texture's side that a material without textures has at least


def read_asset(
    path: Path,
    *,
    note: Note,
    up: Up = "y",
    matrix: np.ndarray | None = None,
    light: Path | None = None,
    light_turn: float = 0.0,
    texture_size: int | None = None,
) -> Assets:
    """Read a textured mesh, and the light that was recovered with it.

    Args:
        path: A .glb, .gltf or .obj file.
        note: Takes one line for each thing that was mended, assumed or left out.
        up: The axis of the file that points up; the asset has z up.
        matrix: (4, 4), moves the asset after that to where the scene has it; its light turns with it.
        light: A lat-long map, OpenEXR or Radiance. Row 0 is up, the middle column is +x of the asset, and +y (z being up) lies a
            quarter to its left, as Blender and three.js have it.
        light_turn: Degrees by which the light is turned about the vertical, counter-clockwise from above: 90 for nvdiffrec's maps.
        texture_size: Texels along a side; larger textures are reduced to that. None for as many as there are.

    Raises:
        InputError: The file, one that it names, or what it asks for cannot be read as one mesh with textures.
    """
    found, surfaces = read_parts(path, note)
    parts = [part for part in found if with_area(part.vertices, part.faces).any()]
    if not parts:
        raise InputError(f"{path}: expected triangles, found none")
    if empty := len(found) - len(parts):
        note(f"{path.name}: {empty} of {len(found)} parts have no surface and are left out")
    surfaces = {name: _reduced(surfaces[name], texture_size) for name in dict.fromkeys(part.material for part in parts)}
    for name, surface in surfaces.items():
        for what, image in surface.maps.items():
            end, expected = (math.inf, "of 0 and more") if what == "albedo" else (1.0, "from 0 to 1")
            if not (image.min() >= -ROUNDING and image.max() <= end + ROUNDING):
                raise InputError(f"{path}: {name}: expected {what} {expected}, found {image.min():.4g} to {image.max():.4g}")
    parts = [_with_uv(path, part, surfaces) for part in parts]
    shares = Counter(part.material for part in parts)
    for place, part in enumerate(parts):
        name, side = f"{part.material}, part {place}", texture_size or BAKED
        if shares[part.material] > 1 and all(image.shape[:2] == (1, 1) for image in surfaces[part.material].maps.values()):
            parts[place], surfaces[name] = replace(part, material=name), surfaces[part.material]  # or coordinates would overlap
        if part.colours is not None:
            note(f"{path.name}: colours of vertices, linear as glTF has them, are baked into {side} x {side} texels")
            parts[place], surfaces[name] = _baked(path, replace(part, material=name), surfaces[part.material], side)
    surfaces = {part.material: surfaces[part.material] for part in parts}
    parts, surface, assumed = _as_one(path, parts, surfaces, note)
    mesh = _joined(path, parts, note)
    if (share := _overlap(mesh)) > OVERLAP:
        told = "lies over others in texture coordinates, where light that the object throws onto itself is kept: renders are wrong"
        note(f"warning: {path.name}: {share:.0%} of the surface {told}")
    assert surface.roughness is not None
    asset = moved(Assets(mesh, surface.albedo, surface.roughness, surface.metallic, assumed=assumed), TO_Z_UP[up])
    if light is not None:
        asset = replace(asset, light=turned(read_light(light), Rotation.from_euler("z", light_turn, degrees=True).as_matrix()))
    return asset if matrix is None else moved(asset, np.asarray(matrix, np.float64))


def moved(asset: Assets, matrix: np.ndarray) -> Assets:
    """The asset where a ``matrix`` (4, 4) moves it, its light turned, or mirrored, by the orthogonal matrix nearest to it."""
    mesh, linear = asset.mesh, matrix[:3, :3]
    left, _, right = np.linalg.svd(linear)
    place = Mesh(
        (mesh.vertices @ linear.T + matrix[:3, 3]).astype(np.float32),
        np.ascontiguousarray(wound(mesh.faces, matrix)),
        turned_normals(mesh.normals, matrix).astype(np.float32),
        mesh.uv,
    )
    return replace(asset, mesh=place, light=None if asset.light is None else turned(asset.light, left @ right))


# ---- one mesh with one set of textures -----------------------------------------------------------------------------


def _with_uv(path: Path, part: Part, surfaces: Mapping[str, Surface]) -> Part:
    """The part with texture coordinates in [0, 1]: its own, or new ones where all its maps are one value and these are no use."""
    large = [name for name, image in surfaces[part.material].maps.items() if image.shape[:2] != (1, 1)]
    found = "none"
    if part.uv is not None and (large or np.ptp(part.uv, axis=0).all()):  # some exporters write one place for all
        uv = np.asarray(part.uv, np.float64)
        uv = uv - np.floor(uv.min(0) + OUTSIDE)  # textures repeat: a whole texture further is the same place
        if np.isfinite(uv).all() and uv.max() <= 1 + OUTSIDE:
            return replace(part, uv=uv.clip(0, 1))
        found = f"{np.nanmin(part.uv):.4g} ... {np.nanmax(part.uv):.4g}: bake textures that repeat"
    if large:
        raise InputError(f"{path}: expected texture coordinates within 0 ... 1 for its texture of {large[0]}, found {found}")
    if part.colours is not None:  # which are baked into a texture next
        return replace(part, uv=None)
    return _unwrapped(path, part)[0]


def _baked(path: Path, part: Part, surface: Surface, side: int) -> tuple[Part, Surface]:
    """The part over new texture coordinates, and its maps with ``side`` x ``side`` texels, colours of vertices among them."""
    made, mesh = _unwrapped(path, part)  # triangles and corners keep their order
    atlas = Atlas.of(mesh, side, torch.device("cpu"))
    second, third = atlas.barycentric.T
    weights = torch.stack([1 - second - third, second, third], -1)[..., None]

    def inside(corners: np.ndarray) -> torch.Tensor:
        return (weights * torch.from_numpy(corners[part.faces]).float()[atlas.face]).sum(1)

    assert part.colours is not None
    maps = {}
    for name, image in surface.maps.items():
        found = torch.from_numpy(np.atleast_3d(image)).float()[0, 0].expand(len(atlas.face), -1)
        if image.shape[:2] != (1, 1) and part.uv is not None:
            found = fetch(torch.from_numpy(np.atleast_3d(image)).float(), inside(part.uv))
        texels = (found * inside(part.colours) if name == "albedo" else found)[atlas.row.long()].numpy()
        maps[name] = texels if name == "albedo" else texels[..., 0]
    return made, Surface(**maps)


def _unwrapped(path: Path, part: Part) -> tuple[Part, Mesh]:
    """The part over new texture coordinates, without its colours, and its mesh, which has normals in any case."""
    normals = smooth_normals(part.vertices, part.faces) if part.normals is None else part.normals
    try:
        mesh = unwrap(part.vertices, part.faces, normals)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return Part(mesh.vertices, mesh.faces, None if part.normals is None else mesh.normals, mesh.uv, part.material), mesh


def _as_one(
    path: Path, parts: Sequence[Part], surfaces: Mapping[str, Surface], note: Note
) -> tuple[list[Part], Surface, frozenset[str]]:
    """All parts over one set of square textures, and which of these nobody knows."""
    assumed = frozenset({"roughness"} if any(surface.roughness is None for surface in surfaces.values()) else ())
    if assumed:
        names = ", ".join(name for name, surface in surfaces.items() if surface.roughness is None)
        note(f"{path.name}: roughness of {names} is unknown; renders take {ROUGHNESS}, and it is not scored")
    metal = any(surface.metallic is not None and bool(surface.metallic.any()) for surface in surfaces.values())
    surfaces = surfaces if metal else {name: replace(surface, metallic=None) for name, surface in surfaces.items()}
    absent = {"roughness": ROUGHNESS, **({"metallic": 0.0} if metal else {})}
    full = {
        name: Surface(**{what: np.full((1, 1), value, np.float32) for what, value in absent.items()} | surface.maps)
        for name, surface in surfaces.items()
    }
    sizes = [image.shape[:2] for surface in full.values() for image in surface.maps.values()]
    if len(full) == 1 and all(height == width for height, width in sizes):
        (surface,) = full.values()
        return list(parts), surface, assumed
    size_of = {name: tuple(np.max([image.shape[:2] for image in surface.maps.values()], 0)) for name, surface in full.items()}
    least = max(1, int(np.max(list(size_of.values()))) // PART)  # of one value: reflected light is solved in the same coordinates
    size_of = {name: (least, least) if size == (1, 1) else size for name, size in size_of.items()}
    corners, side = _shelves({name: (height + 2, width + 2) for name, (height, width) in size_of.items()})
    if side > LARGEST_SIDE:
        most = f"at most {LARGEST_SIDE} x {LARGEST_SIDE} texels"
        raise InputError(f"{path}: expected {most} for all textures side by side, found {side} x {side}; make them smaller")
    if len(full) > 1:
        note(f"{path.name}: textures of {len(full)} materials are laid side by side into one of {side} x {side} texels")
    sheets: dict[str, np.ndarray] = {}
    for name, surface in full.items():
        (top, left), (height, width) = corners[name], size_of[name]
        for what, image in surface.maps.items():
            sheet = sheets.setdefault(what, np.zeros((side, side, *image.shape[2:]), np.float32))
            edges = ((1, 1), (1, 1), (0, 0))[: image.ndim]
            sheet[top : top + height + 2, left : left + width + 2] = np.pad(_enlarged(image, height, width), edges, mode="edge")
    placed = []
    for part in parts:
        (top, left), (height, width) = corners[part.material], size_of[part.material]
        assert part.uv is not None
        u, v = part.uv.T
        uv = np.stack([(left + 1 + u * width) / side, 1 - (top + 1 + (1 - v) * height) / side], -1)
        placed.append(replace(part, uv=uv))
    return placed, Surface(**sheets), assumed


def _shelves(sizes: Mapping[str, tuple[int, int]]) -> tuple[dict[str, tuple[int, int]], int]:
    """Where rectangles (height, width) lie in one square, row and column of each, tallest first in rows; and the square's side."""
    area = sum(height * width for height, width in sizes.values())
    limit = max(math.isqrt(area), *(width for _, width in sizes.values()))
    corners, top, left, tall, wide = dict[str, tuple[int, int]](), 0, 0, 0, 0
    for name, (height, width) in sorted(sizes.items(), key=lambda item: -item[1][0]):
        if left and left + width > limit:
            top, left, tall = top + tall, 0, 0
        corners[name] = (top, left)
        left, tall = left + width, max(tall, height)
        wide = max(wide, left)
    return corners, max(wide, top + tall)


def _enlarged(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """An image (H, W[, 3]) looked up bilinearly at the centres of more texels, as a renderer looks it up."""
    if image.shape[:2] == (height, width):
        return image
    if image.shape[:2] == (1, 1):
        return np.broadcast_to(image, (height, width, *image.shape[2:]))
    from scipy.ndimage import map_coordinates

    places = [(np.arange(new) + 0.5) * old / new - 0.5 for new, old in zip((height, width), image.shape, strict=False)]
    grid = np.meshgrid(*places, indexing="ij")
    channels = [map_coordinates(one, grid, order=1, mode="nearest") for one in np.moveaxis(np.atleast_3d(image), -1, 0)]
    return np.stack(channels, -1).reshape(height, width, *image.shape[2:]).astype(np.float32)


def _reduced(surface: Surface, size: int | None) -> Surface:
    """The maps with at most ``size`` texels along a side, each the mean of what it covers."""

    def smaller(image: np.ndarray) -> np.ndarray:
        scale = (size or max(image.shape[:2])) / max(image.shape[:2])
        if scale >= 1:
            return image
        shape = max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1)
        channels = np.moveaxis(np.atleast_3d(image).astype(np.float32), -1, 0)
        box = [np.asarray(Image.fromarray(np.ascontiguousarray(one)).resize(shape, Image.Resampling.BOX)) for one in channels]
        return np.stack(box, -1).reshape(shape[1], shape[0], *image.shape[2:])

    return Surface(**{name: smaller(image) for name, image in surface.maps.items()})


def _joined(path: Path, parts: Sequence[Part], note: Note) -> Mesh:
    """One mesh of all parts."""
    bare = [part.material for part in parts if part.normals is None]
    if 0 < len(bare) < len(parts):  # or the others would lose theirs
        note(f"{path.name}: no normals stored of {', '.join(dict.fromkeys(bare))}; smooth normals computed")
        parts = [
            part if part.normals is not None else replace(part, normals=smooth_normals(part.vertices, part.faces)) for part in parts
        ]
    counts = [len(part.vertices) for part in parts]
    faces = np.concatenate([part.faces + first for part, first in zip(parts, np.cumsum([0, *counts]), strict=False)])
    normals = joined_normals(counts, [part.normals for part in parts])
    vertices, uv = np.concatenate([part.vertices for part in parts]), np.concatenate([part.uv for part in parts])
    mesh, notes = sound_mesh(path, vertices, faces, normals, uv)
    for line in notes:
        note(line)
    return mesh


def _overlap(mesh: Mesh) -> float:
    """The share of the triangles' area in texture coordinates that lies over other triangles, to the texel of a fine atlas."""
    first, second, third = mesh.uv[mesh.faces].astype(np.float64).swapaxes(0, 1)
    area = 0.5 * float(np.abs(np.linalg.det(np.stack([second - first, third - first], 1))).sum())
    return 1 - len(Atlas.of(mesh, BAKED, torch.device("cpu")).face) / BAKED**2 / max(area, 1e-9)


# ---- writing -------------------------------------------------------------------------------------------------------


def glb(mesh: Mesh, albedo: np.ndarray, roughness: np.ndarray, metallic: np.ndarray | None = None) -> bytes:
    """A glTF 2.0 binary: metallic-roughness material, sRGB base colour, roughness in green, metallic in blue; y-up axes.

    ``albedo`` (T, T, 3); ``roughness`` (T', T') and ``metallic`` (T'', T''), None for a dielectric.
    """
    import trimesh  # most of a second, at the end of a run
    from trimesh.visual.material import PBRMaterial

    base_colour = np.round(255 * linear_to_srgb(albedo.clip(0, 1))).astype(np.uint8)
    side = max(len(roughness), 0 if metallic is None else len(metallic))
    packed = np.zeros((side, side, 3), np.uint8)
    packed[..., 1] = np.round(255 * _enlarged(roughness, side, side).clip(0, 1))
    if metallic is not None:
        packed[..., 2] = np.round(255 * _enlarged(metallic, side, side).clip(0, 1))
    material = PBRMaterial(
        name="recovered",
        baseColorTexture=Image.fromarray(base_colour),
        metallicRoughnessTexture=Image.fromarray(packed),
        metallicFactor=0.0 if metallic is None else 1.0,
        roughnessFactor=1.0,
    )
    to_y_up = TO_Z_UP["y"][:3, :3]
    solid = trimesh.Trimesh(
        vertices=mesh.vertices @ to_y_up,
        faces=mesh.faces,
        vertex_normals=mesh.normals @ to_y_up,
        visual=trimesh.visual.TextureVisuals(uv=mesh.uv, material=material),
        process=False,
    )
    return bytes(trimesh.Scene(solid).export(file_type="glb"))
