"""From modelled objects to one triangulated Blender object, and from arrays back to Blender."""

from dataclasses import dataclass

import bpy
import numpy as np
from mesh import Mesh, face_normals
from numpy.typing import NDArray

# isort: split
import bmesh  # can be imported only once bpy is

CONVERTIBLE = {"MESH", "CURVE", "SURFACE", "FONT", "META"}

MIN_AREA = 1e-8
"""Triangles smaller than this are dropped as degenerate (the object is about 2 wide)."""

LOCAL, GENERATED = "recipe_local", "recipe_generated"
"""Point attributes that keep each part's own Object and Generated texture coordinates, which joining would change."""


@dataclass(frozen=True)
class Corners:
    """Triangles of a Blender mesh that have an area: `vertex` (F, 3) into positions (P, 3), normals (F, 3, 3).

    `loop` (F, 3) are the indices of the same corners in the Blender mesh.
    """

    positions: NDArray[np.float32]
    vertex: NDArray[np.int32]
    normals: NDArray[np.float32]
    loop: NDArray[np.intp]


def join_scene() -> bpy.types.Object:
    """Replace all objects of the scene by one triangulated mesh object, modifiers applied, transform the identity.

    Raises:
        RuntimeError: if the scene has no geometry, a part lacks a material, or a closed part is inside out.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    parts = []
    for source in [o for o in bpy.context.scene.objects if o.type in CONVERTIBLE and not o.hide_render]:
        mesh = bpy.data.meshes.new_from_object(source.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph)
        if not mesh.polygons:
            continue
        if not mesh.materials or any(material is None for material in mesh.materials):
            raise RuntimeError(f"part {source.name!r}: expected a material in every slot, found an empty one")
        _store_texture_coordinates(mesh)
        mesh.transform(source.matrix_world)
        if source.matrix_world.is_negative:
            mesh.flip_normals()
        _refuse_inside_out(mesh, source.name)
        parts.append(bpy.data.objects.new(source.name, mesh))
    if not parts:
        raise RuntimeError("the scene has no geometry: build() must leave mesh or curve objects in it")
    for source in list(bpy.data.objects):
        if source not in parts:
            bpy.data.objects.remove(source)
    for part in parts:
        bpy.context.scene.collection.objects.link(part)
        part.select_set(True)
    joined = bpy.context.view_layer.objects.active = parts[0]
    if len(parts) > 1:
        bpy.ops.object.join()
    triangulate = joined.modifiers.new("triangulate", "TRIANGULATE")
    triangulate.keep_custom_normals = True
    bpy.ops.object.modifier_apply(modifier=triangulate.name)
    return joined


def _store_texture_coordinates(mesh: bpy.types.Mesh) -> None:
    """Keep local coordinates, and coordinates relative to the bounding box, as point attributes."""
    local = _read(mesh.vertices, "co").reshape(-1, 3)
    extent = np.ptp(local, axis=0)
    generated = (local - local.min(axis=0)) / np.where(extent > 0, extent, 1)
    for name, values in ((LOCAL, local), (GENERATED, generated)):
        attribute = mesh.attributes.new(name, "FLOAT_VECTOR", "POINT")
        attribute.data.foreach_set("vector", np.ascontiguousarray(values, dtype=np.float32).ravel())


def _refuse_inside_out(mesh: bpy.types.Mesh, name: str) -> None:
    work = bmesh.new()
    work.from_mesh(mesh)
    inside_out = all(edge.is_manifold for edge in work.edges) and work.calc_volume(signed=True) < 0
    work.free()
    if inside_out:
        raise RuntimeError(f"part {name!r}: faces point inward; recalculate its normals in build()")


def _read(collection: bpy.types.bpy_prop_collection, name: str, width: int = 3) -> NDArray[np.float32]:
    values = np.empty(len(collection) * width, dtype=np.float32)
    collection.foreach_get(name, values)
    return values


def corners(mesh: bpy.types.Mesh) -> Corners:
    """The triangles of a triangulated Blender mesh, without the degenerate ones."""
    positions = _read(mesh.vertices, "co").reshape(-1, 3)
    vertex = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", vertex)
    vertex = vertex.reshape(-1, 3)
    normals = _read(mesh.corner_normals, "vector").reshape(-1, 3, 3)
    kept = np.linalg.norm(face_normals(positions, vertex), axis=1) / 2 >= MIN_AREA
    loop = np.arange(vertex.size).reshape(-1, 3)
    return Corners(positions, vertex[kept], normals[kept], loop[kept])


def add_atlas(mesh: bpy.types.Mesh, found: Corners, uv: NDArray[np.float32]) -> None:
    """Add uv (F, 3, 2) as UV layer "atlas", active for baking; the paints keep reading the layer they had."""
    values = np.zeros((len(mesh.loops), 2), dtype=np.float32)
    values[found.loop.ravel()] = uv.reshape(-1, 2)
    layer = mesh.uv_layers.new(name="atlas", do_init=False)
    layer.data.foreach_set("uv", values.ravel())
    layer.active = True


def to_blender(mesh: Mesh) -> bpy.types.Object:
    """Replace everything in the scene by this mesh, shaded with exactly its vertex normals; UV layer "atlas"."""
    for old in list(bpy.data.objects):
        bpy.data.objects.remove(old)
    data = bpy.data.meshes.new("object")
    data.from_pydata(mesh.positions.tolist(), [], mesh.faces.tolist())
    normals = data.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
    normals.data.foreach_set("vector", np.ascontiguousarray(mesh.normals).ravel())
    layer = data.uv_layers.new(name="atlas", do_init=False)
    layer.data.foreach_set("uv", np.ascontiguousarray(mesh.uv[mesh.faces]).ravel())
    data.shade_smooth()
    data.update()
    shaded = _read(data.corner_normals, "vector").reshape(-1, 3)
    error = float(np.abs(shaded - mesh.normals[mesh.faces.ravel()]).max())
    if error > 1e-5:
        raise RuntimeError(f"Blender shades with other normals than the mesh's (difference {error:.1e})")
    item = bpy.data.objects.new("object", data)
    bpy.context.scene.collection.objects.link(item)
    return item
