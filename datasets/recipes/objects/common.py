"""Helpers shared by the object recipes: meshes from point grids, tubes, and materials written as expressions.

Every object keeps an identity transform, so that Object texture coordinates stay the same after joining.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence

import bpy
import numpy as np

# isort: split
import bmesh  # bmesh and mathutils can be imported only after bpy
from mathutils import Matrix, Vector

Socket = bpy.types.NodeSocket
Value = Socket | float | Sequence[float]


# ---------------------------------------------------------------- materials
class Paint:
    """Material with one Principled BSDF whose inputs are built from expressions of node sockets.

    Methods add one node each and return its output socket; `finish` connects base colour and roughness.
    Arguments named `Value` take a socket, a number, or a linear RGB / vector triple.
    """

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.nodes = self.material.node_tree.nodes
        self.links = self.material.node_tree.links
        self.nodes.clear()

    def _set(self, socket: Socket, value: Value) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.links.new(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def position(self) -> Socket:
        """Object coordinates (world coordinates, as transforms are identities)."""
        return self.nodes.new("ShaderNodeTexCoord").outputs["Object"]

    def local(self, matrix: Matrix) -> Socket:
        """Position in the frame of `matrix` (a rotation and a translation)."""
        node = self.nodes.new("ShaderNodeMapping")
        node.vector_type = "TEXTURE"  # applies the inverse
        self._set(node.inputs["Vector"], self.position())
        node.inputs["Location"].default_value = matrix.to_translation()
        node.inputs["Rotation"].default_value = matrix.to_euler()
        return node.outputs["Vector"]

    def attribute(self, name: str) -> Socket:
        """Vector attribute of the mesh."""
        node = self.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Vector"]

    def split(self, vector: Socket) -> tuple[Socket, Socket, Socket]:
        """Components of a vector."""
        node = self.nodes.new("ShaderNodeSeparateXYZ")
        self._set(node.inputs[0], vector)
        return node.outputs[0], node.outputs[1], node.outputs[2]

    def join(self, x: Value, y: Value, z: Value) -> Socket:
        """Vector from components."""
        node = self.nodes.new("ShaderNodeCombineXYZ")
        for socket, value in zip(node.inputs, (x, y, z), strict=True):
            self._set(socket, value)
        return node.outputs[0]

    def math(self, operation: str, *values: Value) -> Socket:
        """Scalar operation of Blender's Math node, such as 'ADD' or 'MULTIPLY'."""
        node = self.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self._set(socket, value)
        return node.outputs[0]

    def formula(self, text: str, **names: Value) -> Socket:
        """Math nodes from a Python expression of + - * /, numbers, `names`, and Math operations in lower case.

        For example ``formula("absolute(v - 0.5) * 2", v=across)``.
        """
        operators = {ast.Add: "ADD", ast.Sub: "SUBTRACT", ast.Mult: "MULTIPLY", ast.Div: "DIVIDE"}

        def visit(node: ast.expr) -> Value:
            if isinstance(node, ast.BinOp) and type(node.op) in operators:
                return self.math(operators[type(node.op)], visit(node.left), visit(node.right))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                return self.math(node.func.id.upper(), *(visit(argument) for argument in node.args))
            if isinstance(node, ast.Name):
                return names[node.id]
            if isinstance(node, ast.Constant):
                return node.value
            raise ValueError(f"formula {text!r}: expected + - * /, calls, names or numbers, found {ast.dump(node)}")

        return visit(ast.parse(text, mode="eval").body)

    def vector(self, operation: str, *values: Value) -> Socket:
        """Operation of the Vector Math node; 'LENGTH', 'DISTANCE' and 'DOT_PRODUCT' return a scalar."""
        node = self.nodes.new("ShaderNodeVectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self._set(socket, value)
        return node.outputs["Value" if operation in ("LENGTH", "DISTANCE", "DOT_PRODUCT") else "Vector"]

    def smooth(self, value: Value, start: float, end: float, low: Value = 0.0, high: Value = 1.0) -> Socket:
        """`low` where value is at `start`, `high` where it is at `end`, a smoothstep between (start < end)."""
        node = self.nodes.new("ShaderNodeMapRange")
        node.interpolation_type = "SMOOTHSTEP"
        for socket, item in zip(node.inputs, (value, start, end, low, high), strict=False):
            self._set(socket, item)
        return node.outputs[0]

    def noise(self, coordinates: Socket, scale: float, detail: float = 3.0) -> Socket:
        """Fractal noise, about 0.5 on average."""
        node = self.nodes.new("ShaderNodeTexNoise")
        self._set(node.inputs["Vector"], coordinates)
        node.inputs["Scale"].default_value = scale
        node.inputs["Detail"].default_value = detail
        return node.outputs["Fac"]

    def random(self, coordinates: Socket) -> Socket:
        """Uniform hash of a vector in [0, 1), for a value per plank, panel or tile."""
        node = self.nodes.new("ShaderNodeTexWhiteNoise")
        self._set(node.inputs["Vector"], coordinates)
        return node.outputs["Value"]

    def voronoi(self, coordinates: Socket, scale: float, flat: bool = False) -> dict[str, Socket]:
        """Nearest Voronoi cell: 'Distance' and 'Position' in units of `coordinates`, random 'Color' of the cell.

        `flat` ignores the third coordinate.
        """
        node = self.nodes.new("ShaderNodeTexVoronoi")
        node.voronoi_dimensions = "2D" if flat else "3D"
        self._set(node.inputs["Vector"], coordinates)
        node.inputs["Scale"].default_value = scale
        return {
            "Distance": self.math("DIVIDE", node.outputs["Distance"], scale),
            "Position": node.outputs["Position"],
            "Color": node.outputs["Color"],
        }

    def mix(self, factor: Value, first: Value, second: Value) -> Socket:
        """Colour `first` at factor 0, `second` at factor 1 (linear RGB)."""
        node = self.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        self._set(node.inputs["Factor"], factor)
        colours = [socket for socket in node.inputs if socket.type == "RGBA"]
        self._set(colours[0], first)
        self._set(colours[1], second)
        return next(socket for socket in node.outputs if socket.type == "RGBA")

    def blend(self, factor: Value, first: Value, second: Value) -> Socket:
        """Number `first` at factor 0, `second` at factor 1."""
        node = self.nodes.new("ShaderNodeMix")
        for socket, value in zip(node.inputs, (factor, None, first, second), strict=False):
            if value is not None:  # inputs: float factor, vector factor, float A, float B
                self._set(socket, value)
        return node.outputs[0]

    def finish(self, base_color: Value, roughness: Value) -> bpy.types.Material:
        """Connect the two inputs of a dielectric Principled BSDF and return the material."""
        principled = self.nodes.new("ShaderNodeBsdfPrincipled")
        output = self.nodes.new("ShaderNodeOutputMaterial")
        self._set(principled.inputs["Base Color"], base_color)
        self._set(principled.inputs["Roughness"], roughness)
        self.links.new(principled.outputs[0], output.inputs["Surface"])
        return self.material


# ---------------------------------------------------------------- meshes
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
    faces: list[list[int]] = []
    corners: list[np.ndarray] = []
    for i in range(rows - 1):
        for j in range(columns):
            k = (j + 1) % columns
            faces.append([i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j])
            corners += [chart[i, j], chart[i, j + 1], chart[i + 1, j + 1], chart[i + 1, j]]
    for j in range(columns):
        k = (j + 1) % columns
        faces.append([k, j, rows * columns])
        corners += [chart[0, j + 1], chart[0, j], chart[0].mean(axis=0)]
        top = (rows - 1) * columns
        faces.append([top + j, top + k, rows * columns + 1])
        corners += [chart[-1, j], chart[-1, j + 1], chart[-1].mean(axis=0)]
    item = mesh_object(name, vertices, faces, material, sharp_deg)
    layer = item.data.attributes.new("chart", "FLOAT_VECTOR", "CORNER")
    layer.data.foreach_set("vector", np.asarray(corners, np.float32).ravel())
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
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
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
    faces: list[tuple[int, ...]] = [
        (i * m + j, i * m + (j + 1) % m, (i + 1) * m + (j + 1) % m, (i + 1) * m + j)
        for i in range(n - 1)
        for j in range(m)
    ]
    faces += [tuple(range(m)), tuple(range((n - 1) * m, n * m))]
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
    faces = [
        (k * steps + i, k * steps + (i + 1) % steps, (k + 1) * steps + (i + 1) % steps, (k + 1) * steps + i)
        for k in range(len(profile) - 1)
        for i in range(steps)
    ]
    vertices = rings.reshape(-1, 3) @ turn.T + np.asarray(origin, float)
    return solid(name, vertices, faces, material, sharp_deg=sharp_deg)


# ---------------------------------------------------------------- meshes of many parts
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


def loft(rings: Sequence[Sequence[Sequence[float]]], start_cap: bool = True) -> Part:
    """Tube through rings of equally many points, counter-clockwise as seen from ahead, each end closed by one face.

    Without `start_cap` the first end stays open: for parts that stand in another one, where a cap would be hidden.
    """
    count, last = len(rings[0]), (len(rings) - 1) * len(rings[0])
    faces = [
        [base + side, base + (side + 1) % count, base + count + (side + 1) % count, base + count + side]
        for base in range(0, last, count)
        for side in range(count)
    ]
    caps = [list(range(count))[::-1]] if start_cap else []
    return [tuple(point) for ring in rings for point in ring], [*faces, *caps, list(range(last, last + count))]


def frame(origin: Sequence[float], normal: Sequence[float], up: Sequence[float] = (0.0, 0.0, 1.0)) -> Matrix:
    """Matrix whose local z is `normal` and whose local y is as near to `up` as can be."""
    z = Vector(normal).normalized()
    x = Vector(up).cross(z).normalized()
    matrix = Matrix((x, z.cross(x), z)).transposed().to_4x4()
    matrix.translation = Vector(origin)
    return matrix


def apply_modifiers(item: bpy.types.Object) -> None:
    """Replace the object's mesh by the result of its modifiers."""
    mesh = bpy.data.meshes.new_from_object(item.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    item.modifiers.clear()
    item.data = mesh
