"""Meshes of many parts: prisms and turned pieces with one material a face, collected into one object and cut by others."""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
import numpy as np

# isort: split
import bmesh  # bmesh and mathutils can be imported only after bpy
from mathutils import Matrix, Vector

from .forms import mesh_object, tube

Part = tuple[list[tuple[float, float, float]], list[list[int]]]  # vertices, faces


class Parts:
    """Collects parts, each of one material or of one material a face, into one mesh."""

    def __init__(self, materials: Sequence[bpy.types.Material]) -> None:
        self.materials = list(materials)
        self.vertices: list[Vector] = []
        self.faces: list[list[int]] = []
        self.slots: list[int] = []

    def add(self, part: Part, slot: int | Sequence[int], matrix: Matrix | None = None) -> None:
        """Add a part moved by `matrix`; `slot` is the index of its material, or one index for each face."""
        vertices, faces = part
        first = len(self.vertices)
        move = Matrix.Identity(4) if matrix is None else matrix
        self.vertices += [move @ Vector(vertex) for vertex in vertices]
        self.faces += [[first + index for index in face] for face in faces]
        self.slots += [slot] * len(faces) if isinstance(slot, int) else list(slot)

    def link(self, name: str, sharp_deg: float = 40.0) -> bpy.types.Object:
        """Smooth-shaded object of all parts; edges over `sharp_deg` degrees are kept sharp."""
        item = mesh_object(name, np.array(self.vertices), self.faces, self.materials[0], sharp_deg)
        for material in self.materials[1:]:
            item.data.materials.append(material)
        item.data.polygons.foreach_set("material_index", self.slots)
        return item


# ---------------------------------------------------------------- single parts
def loft(rings: Sequence[Sequence[Sequence[float]]], start_cap: bool = True) -> Part:
    """Tube through rings of equally many points, counter-clockwise as seen from ahead, each end closed by one face.

    Without `start_cap` the first end stays open: for parts that stand in another one, where a cap would be hidden.
    """
    count, last = len(rings[0]), (len(rings) - 1) * len(rings[0])
    caps = [list(range(count))[::-1]] if start_cap else []
    return [tuple(point) for ring in rings for point in ring], [*tube(len(rings), count), *caps, list(range(last, last + count))]


def rounded_rectangle(half_u: float, half_v: float, radius: float, steps: int) -> list[tuple[float, float]]:
    """Rounded rectangle, counterclockwise, ``steps`` + 1 points a corner."""
    points = []
    for quarter, (u, v) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for step in range(steps + 1):
            turn = math.pi / 2 * (quarter + step / steps)
            points.append((u * (half_u - radius) + radius * math.cos(turn), v * (half_v - radius) + radius * math.sin(turn)))
    distinct = [p for i, p in enumerate(points) if math.dist(p, points[i - 1]) > 1e-6]
    return distinct


def turned(profile: list[tuple[float, float]], segments: int, start_cap: bool = True) -> Part:
    """Solid of revolution about z through (radius > 0, z), closed by flat ends."""
    turns = [2 * math.pi * step / segments for step in range(segments)]
    return loft([[(r * math.cos(turn), r * math.sin(turn), z) for turn in turns] for r, z in profile], start_cap)


def slab(
    half_u: float,
    half_v: float,
    radius: float,
    levels: list[tuple[float, float]],
    steps: int = 3,
    start_cap: bool = True,
) -> Part:
    """Prism over a rounded rectangle; ``levels`` lists (how much wider, z)."""
    return loft(
        [[(u, v, z) for u, v in rounded_rectangle(half_u + wider, half_v + wider, radius + wider, steps)] for wider, z in levels],
        start_cap,
    )


# ---------------------------------------------------------------- cutting
def cut_out(item: bpy.types.Object, cutters: Parts, name: str) -> None:
    """Cut the parts of `cutters` out of an object and triangulate it; the new faces keep the cutters' materials.

    The cutters exist as object `name` for as long as it takes.
    """
    cutter = cutters.link(name)
    cut = item.modifiers.new("openings", "BOOLEAN")
    cut.operation, cut.solver, cut.material_mode, cut.object = "DIFFERENCE", "EXACT", "TRANSFER", cutter
    apply_modifiers(item)
    bpy.data.objects.remove(cutter)
    _merge_close(item)


def _merge_close(made: bpy.types.Object) -> None:
    """Merge what a Boolean left closer than a hair, and triangulate."""
    graph = bmesh.new()
    graph.from_mesh(made.data)
    bmesh.ops.remove_doubles(graph, verts=graph.verts, dist=2e-4)
    bmesh.ops.dissolve_degenerate(graph, edges=graph.edges, dist=2e-4)
    bmesh.ops.triangulate(graph, faces=graph.faces, quad_method="BEAUTY", ngon_method="BEAUTY")
    graph.to_mesh(made.data)
    graph.free()


def apply_modifiers(item: bpy.types.Object) -> None:
    """Replace the object's mesh by the result of its modifiers."""
    mesh = bpy.data.meshes.new_from_object(item.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    item.modifiers.clear()
    item.data = mesh
