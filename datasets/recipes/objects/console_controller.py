"""The controller of the game console: a body blended from simple solids, with sticks, pad, buttons, triggers and studs.

In its own frame x points to its right, y away from the player, z out of its face.
"""

from __future__ import annotations

import math

import bpy
import numpy as np

# isort: split
import bmesh  # bmesh and mathutils can be imported only after bpy
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from . import console_paint as paint
from .forms import frame
from .parts import Part, Parts, apply_modifiers, cut_out, loft, slab, turned

SIZE, LEAN, YAW = 1.08, math.radians(33.0), math.radians(-9.0)  # scale, tilt and turn of the controller
GRIP = ((0.285, 0.02, -0.012), (0.375, -0.285, -0.085), 0.098, 0.062)  # axis from, axis to, radius there


def _distance(points: np.ndarray) -> np.ndarray:
    """Signed distance (N,) of ``points`` (N, 3) to the body: a flat bar, two lobes and two grips, blended."""
    p = np.column_stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]])
    q = np.abs(p - (0.0, 0.045, 0.0)) - (0.26, 0.095, 0.022)
    bar = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - 0.040
    radii = np.array((0.165, 0.160, 0.078))
    lobe_at = p - (0.265, 0.045, 0.0)
    k = np.linalg.norm(lobe_at / radii, axis=1)
    lobe = k * (k - 1) / np.maximum(np.linalg.norm(lobe_at / radii**2, axis=1), 1e-6)
    start, end, thick, thin = np.array(GRIP[0]), np.array(GRIP[1]), GRIP[2], GRIP[3]
    along = np.clip((p - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    grip = np.linalg.norm(p - start - along[:, None] * (end - start), axis=1) - (thick + along * (thin - thick))
    union = bar
    for other, soft in ((lobe, 0.05), (grip, 0.06)):
        h = np.clip(0.5 + 0.5 * (other - union) / soft, 0, 1)
        union = other + h * (union - other) - soft * h * (1 - h)
    return union


def _skin(materials: list[bpy.types.Material]) -> bpy.types.Object:
    """Mesh of the body: a coarse voxel remesh, relaxed and pulled onto the zero of the signed distance."""
    rough = Parts(materials)
    balls = [((0.0, 0.045, 0.0), (0.34, 0.13, 0.06)), ((0.265, 0.045, 0.0), (0.165, 0.16, 0.075))]
    start, end = Vector(GRIP[0]), Vector(GRIP[1])
    balls += [(start.lerp(end, t / 5), (GRIP[2] + (GRIP[3] - GRIP[2]) * t / 5,) * 3) for t in range(6)]
    for centre, radii in balls:
        for sign in (1, -1):
            turns = [math.pi * (i + 0.5) / 12 for i in range(12)]
            ball = turned([(math.sin(t), -math.cos(t)) for t in turns], 24)
            rough.add(ball, 0, Matrix.Translation((sign * centre[0], centre[1], centre[2])) @ Matrix.Diagonal((*radii, 1.0)))
    made = rough.link("controller_body")
    remesh = made.modifiers.new("skin", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", 0.0235
    apply_modifiers(made)
    graph = bmesh.new()
    graph.from_mesh(made.data)
    for _ in range(8):
        bmesh.ops.smooth_vert(graph, verts=graph.verts, factor=0.5, use_axis_x=True, use_axis_y=True, use_axis_z=True)
        points = np.array([vertex.co for vertex in graph.verts])
        for _ in range(4):
            value = _distance(points)
            slope = np.column_stack([_distance(points + e) - value for e in np.eye(3) * 1e-4]) / 1e-4
            points -= (value / np.maximum((slope**2).sum(axis=1), 0.1))[:, None] * slope
        for vertex, point in zip(graph.verts, points, strict=True):
            vertex.co = point
    # The seam between the two half shells: a V-shaped groove along a plane that follows the grips downward.
    normal, middle = Vector((0.0, -0.22, 1.0)).normalized(), Vector((0.0, 0.0, -0.012))
    for offset in (-0.006, 0.006, 0.0):
        everything = [*graph.verts, *graph.edges, *graph.faces]
        bmesh.ops.bisect_plane(graph, geom=everything, plane_co=middle + normal * offset, plane_no=normal, dist=0.002)
    graph.normal_update()
    for vertex in graph.verts:
        if abs((vertex.co - middle).dot(normal)) < 0.0021:
            vertex.co -= vertex.normal * 0.010
    for face in graph.faces:
        face.material_index = int((face.calc_center_median() - middle).dot(normal) < 0)
    graph.to_mesh(made.data)
    graph.free()
    return made


def _placement(points: np.ndarray, wall: float, floor: float) -> Matrix:
    """Lean the controller on the plane x = `wall`: its grips touch the floor and its back touches the wall."""
    face = Vector((math.cos(LEAN), 0.0, math.sin(LEAN)))
    turn = Matrix.Rotation(YAW, 4, "Z") @ frame((0.0, 0.0, 0.0), face) @ Matrix.Scale(SIZE, 4)
    moved = points @ np.array(turn.to_3x3()).T
    return Matrix.Translation((wall - moved[:, 0].min(), -0.02, floor - moved[:, 2].min())) @ turn


def _pebble(half: tuple[float, float, float], power: float, columns: int = 20, rows: int = 9) -> Part:
    """Superellipsoid: rounder for ``power`` near 1, boxier for smaller values."""

    def signed(value: float) -> float:
        return math.copysign(abs(value) ** power, value)

    rings = []
    for row in range(rows):
        tilt = math.pi * (row + 0.35) / (rows - 0.3)
        rings.append(
            [
                (
                    half[0] * signed(math.sin(tilt)) * signed(math.cos(turn)),
                    half[1] * signed(math.sin(tilt)) * signed(math.sin(turn)),
                    -half[2] * signed(math.cos(tilt)),
                )
                for turn in (2 * math.pi * (column + 0.5) / columns for column in range(columns))
            ]
        )
    return loft(rings)


def _cross(arm: float, width: float, levels: list[tuple[float, float]]) -> Part:
    """Prism over a cross; ``levels`` lists (how much smaller, z)."""
    rings = []
    for less, z in levels:
        a, w = arm - less, width - less
        corner = [(a, -w), (a, w), (w, w)]
        ring = []
        for quarter in range(4):
            c, s = round(math.cos(math.pi / 2 * quarter)), round(math.sin(math.pi / 2 * quarter))
            ring += [(c * u - s * v, s * u + c * v, z) for u, v in corner]
        rings.append(ring)
    return loft(rings, start_cap=False)


def _studs(skin: BVHTree) -> Part:
    """Low five-sided studs in staggered rows over the grips, except on the side of the face."""
    vertices: list[tuple[float, float, float]] = []
    faces: list[list[int]] = []
    for sign in (1, -1):
        start, end = (Vector((sign * p[0], p[1], p[2])) for p in GRIP[:2])
        axis = (end - start).normalized()
        outward = axis.cross(Vector((0, 0, 1))).normalized() * -sign
        down = axis.cross(outward).normalized()
        down *= -1 if down.z > 0 else 1
        for row in range(11):
            centre = start.lerp(end, 0.42 + 0.058 * row)
            for column in range(-5, 6):
                turn = math.radians(17.0) * (column + 0.5 * (row % 2)) + math.radians(35.0)
                ray = outward * math.cos(turn) + down * math.sin(turn)
                spot, normal, _, _ = skin.ray_cast(centre + ray * 0.3, -ray)
                if spot is None or (spot - centre).length > 0.12:
                    continue
                base, at = len(vertices), frame(spot, normal, axis)
                for step in range(5):
                    angle = 2 * math.pi * step / 5
                    vertices.append(tuple(at @ Vector((0.0085 * math.cos(angle), 0.0085 * math.sin(angle), -0.002))))
                vertices.append(tuple(at @ Vector((0.0, 0.0, 0.0055))))
                faces += [[base + step, base + (step + 1) % 5, base + 5] for step in range(5)]
    return vertices, faces


def build_controller(
    light: bpy.types.Material, inside: bpy.types.Material, accents: list[bpy.types.Material], wall: float, floor: float
) -> None:
    """Build the controller leaning on the plane x = `wall`; ``accents`` are red, yellow, green and blue."""
    top = paint.plain("controller_top", (0.80, 0.80, 0.78), (0.56, 0.28))
    lower = paint.plain("controller_lower", (0.44, 0.44, 0.45), (0.62, 0.42))
    skin = _skin([top, lower, inside])
    surface = BVHTree.FromObject(skin, bpy.context.evaluated_depsgraph_get())

    def on_face(x: float, y: float, lift: float = 0.0) -> Matrix:
        spot, normal, _, _ = surface.ray_cast(Vector((x, y, 1.0)), Vector((0, 0, -1)))
        upright = (normal + Vector((0, 0, 2.0))).normalized()
        return frame(spot + upright * lift, upright, (0, 1, 0))

    cutters = Parts([top, lower, inside])
    sticks = [on_face(sign * 0.125, -0.025) for sign in (-1, 1)]
    for at in sticks:
        cutters.add(turned([(0.063, -0.036), (0.063, 0.03)], 24), 2, at)
    pad = on_face(-0.285, 0.075)
    cutters.add(turned([(0.068, -0.009), (0.070, 0.03)], 28), 1, pad)
    cluster = on_face(0.285, 0.075)
    spots = [cluster @ Matrix.Translation((0.052 * u, 0.052 * v, 0.0)) for u, v in ((1, 0), (0, 1), (0, -1), (-1, 0))]
    for at in spots:
        cutters.add(turned([(0.0265, -0.02), (0.0265, 0.03)], 16), [2] * 16 + [2, 2], at)
    port = frame((0.0, 0.175, 0.0), (0, 1, 0))
    cutters.add(slab(0.030, 0.011, 0.010, [(0.0, -0.03), (0.0, 0.03)], 3), 2, port)
    cut_out(skin, cutters, "controller_cutters")
    skin.data.shade_smooth()
    skin.data.set_sharp_from_angle(angle=math.radians(40.0))

    parts = Parts([light, inside, lower, *accents, paint.plain("controller_sticks", (0.13, 0.13, 0.14), (0.65, 0.40))])
    collar = [(0.068, -0.034), (0.068, 0.0045), (0.064, 0.0075), (0.059, 0.003), (0.054, -0.034)]
    cap = [(0.024, -0.033), (0.024, 0.016), (0.046, 0.024), (0.051, 0.029), (0.051, 0.036), (0.047, 0.040)]
    cap += [(0.041, 0.040), (0.034, 0.035), (0.016, 0.032)]
    for at, tilt in zip(sticks, ((0.0, 0.0), (0.12, -0.10)), strict=True):
        lean = Matrix.Rotation(tilt[0], 4, "X") @ Matrix.Rotation(tilt[1], 4, "Y")
        parts.add(turned(cap, 24, start_cap=False), 7, at @ lean)
        parts.add(turned(collar, 28, start_cap=False), [0] * 84 + [1] * 29, at)
    cross = [(0.0, -0.012), (0.0, 0.006), (0.004, 0.011), (0.008, 0.012)]
    parts.add(_cross(0.056, 0.019, cross), 1, pad)
    dome = [(0.0245, -0.02), (0.0245, 0.006), (0.0225, 0.011), (0.017, 0.0145), (0.008, 0.016)]
    for at, slot in zip(spots, (3, 4, 5, 6), strict=True):
        parts.add(turned(dome, 16, start_cap=False), slot, at)
    parts.add(turned([(0.026, -0.01), (0.026, 0.004), (0.023, 0.008), (0.010, 0.010)], 18, False), 0, on_face(0.0, 0.085))
    parts.add(turned([(0.033, -0.01), (0.033, 0.002)], 24, False), 6, on_face(0.0, 0.085))
    for sign in (-1, 1):
        pill = slab(0.009, 0.020, 0.009, [(0.0, -0.01), (0.0, 0.003), (-0.003, 0.006)], 3, False)
        parts.add(pill, 1, on_face(sign * 0.115, 0.105) @ Matrix.Rotation(sign * -0.2, 4, "Z"))
        outward = Matrix.Rotation(-sign * 0.22, 4, "Z")
        bumper = Matrix.Translation((sign * 0.265, 0.178, 0.026)) @ outward
        parts.add(_pebble((0.112, 0.034, 0.020), 0.45), 0, bumper)
        trigger = Matrix.Translation((sign * 0.285, 0.172, -0.040)) @ outward @ Matrix.Rotation(0.45, 4, "X")
        parts.add(_pebble((0.078, 0.062, 0.034), 0.55), 2, trigger)
    parts.add(_studs(surface), 2)
    fittings = parts.link("controller_fittings")

    points = np.array([vertex.co for item in (skin, fittings) for vertex in item.data.vertices])
    placement = _placement(points, wall, floor)
    for item in (skin, fittings):
        item.data.transform(placement)
