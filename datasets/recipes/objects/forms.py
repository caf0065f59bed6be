"""Forms that objects are made of: surfaces through rings and grids of points, tubes, solids with hard edges.

Every object keeps an identity transform, so that Object texture coordinates stay the same after joining.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

# isort: split
import bmesh  # bmesh and mathutils can be imported only after bpy
from mathutils import Matrix, Vector


# ---------------------------------------------------------------- surfaces
def cells(grid: np.ndarray) -> np.ndarray:
    """Corners (n, 4, ...) of the cells of a grid (rows, columns, ...), row by row; they face (d/d column) x (d/d row)."""
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, *grid.shape[2:])


def tube(rows: int, columns: int) -> list[list[int]]:
    """Faces between rings of numbered points (rows, columns), each of which closes on itself."""
    return cells(np.pad(np.arange(rows * columns).reshape(rows, columns), ((0, 0), (0, 1)), "wrap")).tolist()


def store_chart(item: bpy.types.Object, corners: np.ndarray) -> None:
    """Store three numbers for every corner of every face, in their order, as the attribute 'chart' for painting."""
    layer = item.data.attributes.new("chart", "FLOAT_VECTOR", "CORNER")
    layer.data.foreach_set("vector", np.asarray(corners, np.float32).ravel())


def mesh_object(
    name: str, vertices: np.ndarray, faces: Sequence[Sequence[int]], material: bpy.types.Material, sharp_deg: float = 180.0
) -> bpy.types.Object:
    """Smooth-shaded object from vertices (n, 3) and faces; edges over `sharp_deg` degrees are kept sharp."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices, float).tolist(), [], [list(map(int, face)) for face in faces])
    mesh.materials.append(material)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    if sharp_deg < 180.0:
        mesh.set_sharp_from_angle(angle=np.radians(sharp_deg))
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def grid_surface(
    name: str,
    points: np.ndarray,
    material: bpy.types.Material,
    chart: np.ndarray | None = None,
    sharp_deg: float = 180.0,
) -> bpy.types.Object:
    """Closed surface through rings of points (rows, columns, 3); every ring closes on itself.

    Columns run counter-clockwise about the direction of ascending rows as seen from ahead of it (+z for a lathe built
    upwards), so that normals point outwards. The first and last ring are capped with a fan about their mean.
    `chart` (rows, columns + 1, 3), default (column fraction, row fraction, 0), is stored per face corner as attribute
    'chart' for painting; its last column is the other side of the seam, and a cap has the mean of its ring.
    """
    rows, columns, _ = points.shape
    if chart is None:
        v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns + 1), indexing="ij")
        chart = np.stack([u, v, np.zeros_like(u)], axis=-1)
    vertices = np.vstack([points.reshape(-1, 3), points[0].mean(axis=0), points[-1].mean(axis=0)])
    faces, corners = tube(rows, columns), [*cells(chart).reshape(-1, 3)]
    for j in range(columns):
        k = (j + 1) % columns
        faces.append([k, j, rows * columns])
        corners += [chart[0, j + 1], chart[0, j], chart[0].mean(axis=0)]
        top = (rows - 1) * columns
        faces.append([top + j, top + k, rows * columns + 1])
        corners += [chart[-1, j], chart[-1, j + 1], chart[-1].mean(axis=0)]
    item = mesh_object(name, vertices, faces, material, sharp_deg)
    store_chart(item, np.asarray(corners))
    return item


def tube_along_curve(
    name: str, path: np.ndarray, radii: np.ndarray, material: bpy.types.Material, sides: int = 8, flatness: float = 1.0
) -> bpy.types.Object:
    """Capped tube round a path (n, 3); `flatness` scales the cross-section's second axis.

    Radii are (n,) or, varying round the tube, (n, sides).
    """
    path = np.asarray(path, float)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.cross(tangents[0], (0.0, 0.0, 1.0) if abs(tangents[0, 2]) < 0.9 else (0.0, 1.0, 0.0))
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    rings = np.empty((len(path), sides, 3))
    for i, (centre, tangent, radius) in enumerate(zip(path, tangents, radii, strict=True)):
        side = side - tangent * (side @ tangent)  # transported without twist
        side /= np.linalg.norm(side)
        other = np.cross(tangent, side)
        section = np.outer(np.cos(angles), side) + flatness * np.outer(np.sin(angles), other)
        rings[i] = centre + np.reshape(radius, (-1, 1)) * section
    return grid_surface(name, rings, material)


def smooth_path(points: list[tuple[float, float, float]] | np.ndarray, count: int) -> np.ndarray:
    """Points (count, 3) on the Catmull-Rom spline through the given ones."""
    p = np.asarray(points, float)
    p = np.vstack([2 * p[0] - p[1], p, 2 * p[-1] - p[-2]])
    s = np.linspace(0.0, len(p) - 3 - 1e-9, count)
    i, f = s.astype(int), (s % 1.0)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    return 0.5 * (2 * b + f * (c - a) + f**2 * (2 * a - 5 * b + 4 * c - d) + f**3 * (3 * b - a - 3 * c + d))


# ---------------------------------------------------------------- solids with hard edges
def solid(
    name: str,
    vertices: np.ndarray | Sequence[Sequence[float]],
    faces: Sequence[Sequence[int]],
    material: bpy.types.Material,
    bevel: float = 0.0,
    sharp_deg: float = 40.0,
    segments: int = 2,
) -> bpy.types.Object:
    """Closed object with outward normals: doubles welded, collapsed faces dropped, edges over 30 degrees bevelled."""
    item = mesh_object(name, np.asarray(vertices, float), faces, material)
    work = bmesh.new()
    work.from_mesh(item.data)
    bmesh.ops.remove_doubles(work, verts=work.verts, dist=1e-6)
    bmesh.ops.recalc_face_normals(work, faces=work.faces)
    if bevel > 0.0:
        edges = [edge for edge in work.edges if edge.is_manifold and edge.calc_face_angle() > np.radians(30.0)]
        bmesh.ops.bevel(work, geom=edges, offset=bevel, segments=segments, profile=0.6, affect="EDGES")
    for face in work.faces:
        face.smooth = True
    work.to_mesh(item.data)
    work.free()
    item.data.set_sharp_from_angle(angle=np.radians(sharp_deg))
    return item


def box(
    name: str,
    centre: Sequence[float],
    size: Sequence[float],
    material: bpy.types.Material,
    bevel: float = 0.0,
    turn: Matrix | None = None,
    segments: int = 2,
) -> bpy.types.Object:
    """Box of full extents `size`, turned about its centre by the 3x3 matrix `turn`."""
    signs = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = signs * np.asarray(size, float)
    if turn is not None:
        corners = corners @ np.array(turn).T
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return solid(name, corners + np.asarray(centre, float), faces, material, bevel, segments=segments)


def plate(
    name: str,
    outline: Sequence[Sequence[float]] | np.ndarray,
    thickness: Sequence[float],
    material: bpy.types.Material,
    bevel: float = 0.0,
    segments: int = 2,
) -> bpy.types.Object:
    """Planar polygon (n, 3) grown into a solid by the vector `thickness`, half of it to either side."""
    points = np.asarray(outline, float)
    n, half = len(points), 0.5 * np.asarray(thickness, float)
    sides = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    faces = [tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides]
    return solid(name, np.concatenate([points - half, points + half]), faces, material, bevel, segments=segments)


def sheet(
    name: str, points: np.ndarray, material: bpy.types.Material, thickness: float = 0.0, sharp_deg: float = 40.0
) -> bpy.types.Object:
    """Surface through an open grid of points (rows, columns, 3), facing (d/d column) x (d/d row).

    With `thickness` it is a closed solid, half of it to either side.
    """
    rows, columns, _ = points.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = cells(index)
    flat = points.reshape(-1, 3)
    if thickness <= 0.0:
        return mesh_object(name, flat, quads.tolist(), material, sharp_deg)
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0)).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    following = np.roll(rim, -1)
    edge = np.stack([following, rim, rim + len(flat), following + len(flat)], axis=-1)
    faces = np.concatenate([quads, quads[:, ::-1] + len(flat), edge]).tolist()
    grown = np.concatenate([flat + 0.5 * thickness * normals, flat - 0.5 * thickness * normals])
    return solid(name, grown, faces, material, sharp_deg=sharp_deg)


def sweep(
    name: str,
    path: np.ndarray | Sequence[Sequence[float]],
    profile: np.ndarray | Sequence[Sequence[float]],
    material: bpy.types.Material,
    up: Sequence[float] = (0.0, 0.0, 1.0),
    bevel: float = 0.0,
) -> bpy.types.Object:
    """Moulding: the closed profile (m, 2), x to the right of the path and y toward `up`, along a path (n, 3)."""
    points = np.asarray(path, float)
    n, m = len(points), len(profile)
    tangents = np.gradient(points, axis=0)
    right = np.cross(tangents, np.asarray(up, float))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    top = np.cross(right, tangents)
    top /= np.linalg.norm(top, axis=1, keepdims=True)
    local = np.asarray(profile, float)
    rings = points[:, None] + local[None, :, :1] * right[:, None] + local[None, :, 1:] * top[:, None]
    faces = [*tube(n, m), range(m), range((n - 1) * m, n * m)]
    return solid(name, rings.reshape(-1, 3), faces, material, bevel)


def lathe(
    name: str,
    profile: Sequence[tuple[float, float]],
    material: bpy.types.Material,
    steps: int = 12,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    sharp_deg: float = 40.0,
) -> bpy.types.Object:
    """Solid turned about `axis` through `origin`, from (radius, height) pairs that start and end at radius 0."""
    turn = np.array(Vector((0.0, 0.0, 1.0)).rotation_difference(Vector(axis)).to_matrix())
    angles = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(steps)], axis=1)
    rings = np.array([radius * circle + (0.0, 0.0, height) for radius, height in profile])
    vertices = rings.reshape(-1, 3) @ turn.T + np.asarray(origin, float)
    return solid(name, vertices, tube(len(profile), steps), material, sharp_deg=sharp_deg)


def threads(spines: np.ndarray, sections: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices and faces of short threads along `spines` (n, 4, 3): a point, twice the triangle `sections` (n, 3, 3), a point."""
    rings = (spines[:, 1:3, None] + sections[:, None]).reshape(-1, 6, 3)
    faces: list[list[int]] = []
    for base in range(0, 8 * len(spines), 8):
        for a, b in ((base + 1, base + 2), (base + 2, base + 3), (base + 3, base + 1)):
            faces += [[base, a, b], [b, a, a + 3, b + 3], [b + 3, a + 3, base + 7]]
    return np.concatenate([spines[:, :1], rings, spines[:, 3:]], axis=1).reshape(-1, 3), faces


# ---------------------------------------------------------------- placement
def frame(origin: Sequence[float], normal: Sequence[float], up: Sequence[float] = (0.0, 0.0, 1.0)) -> Matrix:
    """Matrix whose local z is `normal` and whose local y is as near to `up` as can be."""
    z = Vector(normal).normalized()
    x = Vector(up).cross(z).normalized()
    matrix = Matrix((x, z.cross(x), z)).transposed().to_4x4()
    matrix.translation = Vector(origin)
    return matrix
