"""A white game console, standing, with its controller leaning against it.

White things under a coloured light: whether the plastic or the lamp is yellow can be told only from the few saturated
accents, the highlights and one's expectations. The console stands along z, its front looks to -y, and the controller
leans against its glossy +x side.
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
from .common import Part, Parts, apply_modifiers, frame, loft

HALF = (0.285, 0.50, 0.715)  # half extents of the console's box along x, y, z
CENTRE = Vector((-0.195, 0.0, 0.018))
CORNER, EDGE = 0.09, 0.042  # radii of the corners seen from the side, and of the edges around the two sides
FOOT = 0.035
SIDE = CENTRE.x + HALF[0]  # the plane that the controller leans against
FLOOR = CENTRE.z - HALF[2] - FOOT
SIZE, LEAN, YAW = 1.08, math.radians(33.0), math.radians(-9.0)  # scale, tilt and turn of the controller


# ---------------------------------------------------------------- the console


def _outline(half_u: float, half_v: float, radius: float, steps: int) -> list[tuple[float, float]]:
    """Rounded rectangle, counterclockwise, ``steps`` + 1 points a corner."""
    points = []
    for quarter, (u, v) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for step in range(steps + 1):
            turn = math.pi / 2 * (quarter + step / steps)
            points.append(
                (u * (half_u - radius) + radius * math.cos(turn), v * (half_v - radius) + radius * math.sin(turn))
            )
    distinct = [p for i, p in enumerate(points) if math.dist(p, points[i - 1]) > 1e-6]
    return distinct


def _turned(profile: list[tuple[float, float]], segments: int, start_cap: bool = True) -> Part:
    """Solid of revolution about z through (radius > 0, z), closed by flat ends."""
    turns = [2 * math.pi * step / segments for step in range(segments)]
    return loft([[(r * math.cos(turn), r * math.sin(turn), z) for turn in turns] for r, z in profile], start_cap)


def _slab(
    half_u: float,
    half_v: float,
    radius: float,
    levels: list[tuple[float, float]],
    steps: int = 3,
    start_cap: bool = True,
) -> Part:
    """Prism over a rounded rectangle; ``levels`` lists (how much wider, z)."""
    return loft(
        [
            [(u, v, z) for u, v in _outline(half_u + wider, half_v + wider, radius + wider, steps)]
            for wider, z in levels
        ],
        start_cap,
    )


def _recess(
    cutters: Parts, at: Matrix, half_u: float, half_v: float, radius: float, depth: float, steps: int = 3
) -> None:
    """Add a cutter with dark (slot 1) floor and walls and a chamfered rim of the shell's colour (slot 0)."""
    part = _slab(half_u, half_v, radius, [(0.0, -depth), (0.0, -0.005), (0.012, 0.007)], steps)
    count = (len(part[1]) - 2) // 2
    cutters.add(part, [1] * count + [0] * count + [1, 0], at)


def _on(side: str, u: float, v: float) -> Matrix:
    """Frame on a face of the console: z outward; x and y of the frame along (u, v) in the face."""
    axis, sign = {"left": (0, -1), "right": (0, 1), "front": (1, -1), "back": (1, 1), "bottom": (2, -1), "top": (2, 1)}[
        side
    ]
    normal = Vector([sign * (k == axis) for k in range(3)])
    up = (0, 1, 0) if side in ("top", "bottom") else (0, 0, 1)
    matrix = frame(CENTRE + normal * HALF[axis], normal, up)
    return matrix @ Matrix.Translation((u, v, 0.0))


def _housing(materials: list[bpy.types.Material]) -> None:
    """White box, coloured band and glossy side plate, parted by gaps, with every opening cut in.

    ``materials``: shell, insides, band, side plate.
    """
    hx, hy, hz = HALF
    stations: list[tuple[float, float, int]] = []  # x, inset of the section, material of the strip that follows
    for step in range(5):
        turn = math.pi / 8 * step
        stations.append((-hx + EDGE * (1 - math.cos(turn)), EDGE * (1 - math.sin(turn)), 0))
    for x, before, after in ((0.105, 0, 2), (0.155, 2, 3)):
        lip = 0.006
        stations += [(x - lip - 0.005, 0.0, before), (x - 0.005, lip, before), (x - 0.005, 0.024, 1)]
        stations += [(x + 0.005, 0.024, 1), (x + 0.005, lip, after), (x + lip + 0.005, 0.0, after)]
    for step in range(5):
        turn = math.pi / 8 * (4 - step)
        stations.append((hx - EDGE * (1 - math.cos(turn)), EDGE * (1 - math.sin(turn)), 3))
    rings = [[(x, y, z) for y, z in _outline(hy - inset, hz - inset, CORNER - inset, 6)] for x, inset, _ in stations]
    vertices, faces = loft(rings)
    count = len(rings[0])
    slots = [slot for _, _, slot in stations[:-1] for _ in range(count)]
    body = Parts(materials)
    body.add((vertices, faces), [*slots, 0, 3], Matrix.Translation(CENTRE))
    box = body.link("console_housing")

    cutters = Parts(materials[:2])
    for column in range(5):
        for row in range(11 + column % 2):
            spot = _on("top", -0.075 + 0.066 * (column - 2), 0.066 * (row - (5.5 if column % 2 else 5.0)))
            _recess(cutters, spot, 0.0225, 0.0225, 0.0225, 0.05)
    for slot in range(8):  # vents of the left side
        _recess(cutters, _on("left", 0.0, -0.56 + 0.054 * slot), 0.35, 0.012, 0.012, 0.045)
    for slot in range(9):  # vents of the back
        _recess(cutters, _on("back", 0.085, 0.17 + 0.052 * slot), 0.13, 0.011, 0.011, 0.045)
    _recess(cutters, _on("front", 0.0, 0.05), 0.012, 0.44, 0.012, 0.07)  # the disc goes in here
    _recess(cutters, _on("front", -0.145, 0.41), 0.045, 0.045, 0.045, 0.02, 5)  # power button
    _recess(cutters, _on("front", -0.145, 0.29), 0.022, 0.022, 0.022, 0.02)  # eject button
    for v in (-0.24, -0.45):
        _recess(cutters, _on("front", -0.145, v), 0.018, 0.045, 0.004, 0.05, 1)
    ports = ((-0.30, 0.05, 0.020, 0.006), (-0.40, 0.03, 0.030, 0.004), (-0.51, 0.045, 0.028, 0.027))
    for v, half_u, half_v, radius in ports:
        _recess(cutters, _on("back", 0.145, v), half_u, half_v, radius, 0.05, 2)
    for v in (-0.32, -0.40):
        _recess(cutters, _on("back", 0.03, v), 0.022, 0.022, 0.020, 0.04)
    for slot in range(4):
        _recess(cutters, _on("bottom", 0.085 + 0.05 * (slot - 1.5), 0.0), 0.010, 0.17, 0.010, 0.03)
    cutter = cutters.link("console_cutters")
    cut = box.modifiers.new("openings", "BOOLEAN")
    cut.operation, cut.solver, cut.material_mode, cut.object = "DIFFERENCE", "EXACT", "TRANSFER", cutter
    apply_modifiers(box)
    bpy.data.objects.remove(cutter)
    _tidy(box)
    box.data.shade_smooth()
    box.data.set_sharp_from_angle(angle=math.radians(30.0))
    weights = box.modifiers.new("flat faces stay flat", "WEIGHTED_NORMAL")
    weights.keep_sharp, weights.weight = True, 80
    apply_modifiers(box)


def _tidy(made: bpy.types.Object) -> None:
    """Merge what a Boolean left closer than a hair, and triangulate."""
    graph = bmesh.new()
    graph.from_mesh(made.data)
    bmesh.ops.remove_doubles(graph, verts=graph.verts, dist=2e-4)
    bmesh.ops.dissolve_degenerate(graph, edges=graph.edges, dist=2e-4)
    bmesh.ops.triangulate(graph, faces=graph.faces, quad_method="BEAUTY", ngon_method="BEAUTY")
    graph.to_mesh(made.data)
    graph.free()


def _fittings(
    light: bpy.types.Material,
    inside: bpy.types.Material,
    rubber: bpy.types.Material,
    accents: list[bpy.types.Material],
) -> None:
    """Buttons, tongues of the ports, feet, label and sticker of the console; ``accents`` are red, yellow and teal."""
    label_at, sticker_at = _on("back", 0.08, -0.01), _on("left", 0.19, 0.34)
    parts = Parts(
        [light, inside, rubber, *accents, paint.label(label_at, (0.13, 0.085)), paint.sticker(sticker_at, 0.19)]
    )
    button = [(0.041, -0.02), (0.041, 0.002), (0.038, 0.006), (0.028, 0.008), (0.010, 0.005)]
    parts.add(_turned(button, 20, start_cap=False), 0, _on("front", -0.145, 0.41))
    eject = [(0.018, -0.02), (0.018, 0.001), (0.015, 0.004)]
    parts.add(_turned(eject, 14, start_cap=False), 3, _on("front", -0.145, 0.29))
    for v in (-0.24, -0.45):
        tongue = _slab(0.006, 0.036, 0.002, [(0.0, -0.049), (0.0, -0.008)], 1, False)
        parts.add(tongue, 5, _on("front", -0.145, v))
    parts.add(_slab(0.034, 0.005, 0.002, [(0.0, -0.049), (0.0, -0.01)], 1, False), 0, _on("back", 0.145, -0.30))
    for v, slot in ((-0.32, 3), (-0.40, 4)):
        plug = [(0.014, -0.039), (0.014, -0.004), (0.007, -0.004), (0.007, -0.03)]
        parts.add(_turned(plug, 12, start_cap=False), slot, _on("back", 0.03, v))
    for u in (-0.19, 0.19):
        for v in (-0.35, 0.35):
            foot = [(0.060, -0.002), (0.056, 0.028), (0.050, FOOT), (0.030, FOOT), (0.026, FOOT - 0.006)]
            parts.add(_turned(foot, 18, start_cap=False), 2, _on("bottom", u, v))
    parts.add(_slab(0.13, 0.085, 0.012, [(0.0, -0.002), (0.0, 0.003)], 3, False), 6, label_at)
    parts.add(_turned([(0.19, -0.002), (0.19, 0.003)], 40, start_cap=False), 7, sticker_at)
    jewel = [(0.024, -0.002), (0.024, 0.006), (0.020, 0.011), (0.010, 0.014)]
    for place, slot in enumerate((3, 4, 5)):
        parts.add(_turned(jewel, 16, start_cap=False), slot, _on("right", -0.36 + 0.065 * place, 0.57))
    parts.link("console_fittings")


# ---------------------------------------------------------------- the controller
# In its own frame x points to its right, y away from the player, z out of its face.

GRIP = ((0.285, 0.02, -0.012), (0.375, -0.285, -0.085), 0.098, 0.062)  # axis from, axis to, radius there


def _controller_distance(points: np.ndarray) -> np.ndarray:
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


def _controller_skin(materials: list[bpy.types.Material]) -> bpy.types.Object:
    """Mesh of the body: a coarse voxel remesh, relaxed and pulled onto the zero of the signed distance."""
    rough = Parts(materials)
    balls = [((0.0, 0.045, 0.0), (0.34, 0.13, 0.06)), ((0.265, 0.045, 0.0), (0.165, 0.16, 0.075))]
    start, end = Vector(GRIP[0]), Vector(GRIP[1])
    balls += [(start.lerp(end, t / 5), (GRIP[2] + (GRIP[3] - GRIP[2]) * t / 5,) * 3) for t in range(6)]
    for centre, radii in balls:
        for sign in (1, -1):
            turns = [math.pi * (i + 0.5) / 12 for i in range(12)]
            ball = _turned([(math.sin(t), -math.cos(t)) for t in turns], 24)
            rough.add(
                ball, 0, Matrix.Translation((sign * centre[0], centre[1], centre[2])) @ Matrix.Diagonal((*radii, 1.0))
            )
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
            value = _controller_distance(points)
            slope = np.column_stack([_controller_distance(points + e) - value for e in np.eye(3) * 1e-4]) / 1e-4
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


def _controller_placement(points: np.ndarray) -> Matrix:
    """Lean the controller on the console: its grips touch the floor and its back touches the console's side."""
    face = Vector((math.cos(LEAN), 0.0, math.sin(LEAN)))
    turn = Matrix.Rotation(YAW, 4, "Z") @ frame((0.0, 0.0, 0.0), face) @ Matrix.Scale(SIZE, 4)
    moved = points @ np.array(turn.to_3x3()).T
    return Matrix.Translation((SIDE - moved[:, 0].min(), -0.02, FLOOR - moved[:, 2].min())) @ turn


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


def _controller(light: bpy.types.Material, inside: bpy.types.Material, accents: list[bpy.types.Material]) -> None:
    """Build the controller; ``accents`` are red, yellow, green and blue."""
    top = paint.plain("controller_top", (0.80, 0.80, 0.78), (0.56, 0.28))
    lower = paint.plain("controller_lower", (0.44, 0.44, 0.45), (0.62, 0.42))
    skin = _controller_skin([top, lower, inside])
    surface = BVHTree.FromObject(skin, bpy.context.evaluated_depsgraph_get())

    def on_face(x: float, y: float, lift: float = 0.0) -> Matrix:
        spot, normal, _, _ = surface.ray_cast(Vector((x, y, 1.0)), Vector((0, 0, -1)))
        upright = (normal + Vector((0, 0, 2.0))).normalized()
        return frame(spot + upright * lift, upright, (0, 1, 0))

    cutters = Parts([top, lower, inside])
    sticks = [on_face(sign * 0.125, -0.025) for sign in (-1, 1)]
    for at in sticks:
        cutters.add(_turned([(0.063, -0.036), (0.063, 0.03)], 24), 2, at)
    pad = on_face(-0.285, 0.075)
    cutters.add(_turned([(0.068, -0.009), (0.070, 0.03)], 28), 1, pad)
    cluster = on_face(0.285, 0.075)
    spots = [cluster @ Matrix.Translation((0.052 * u, 0.052 * v, 0.0)) for u, v in ((1, 0), (0, 1), (0, -1), (-1, 0))]
    for at in spots:
        cutters.add(_turned([(0.0265, -0.02), (0.0265, 0.03)], 16), [2] * 16 + [2, 2], at)
    port = frame((0.0, 0.175, 0.0), (0, 1, 0))
    cutters.add(_slab(0.030, 0.011, 0.010, [(0.0, -0.03), (0.0, 0.03)], 3), 2, port)
    cutter = cutters.link("controller_cutters")
    cut = skin.modifiers.new("wells", "BOOLEAN")
    cut.operation, cut.solver, cut.material_mode, cut.object = "DIFFERENCE", "EXACT", "TRANSFER", cutter
    apply_modifiers(skin)
    bpy.data.objects.remove(cutter)
    _tidy(skin)
    skin.data.shade_smooth()
    skin.data.set_sharp_from_angle(angle=math.radians(40.0))

    parts = Parts([light, inside, lower, *accents, paint.plain("controller_sticks", (0.13, 0.13, 0.14), (0.65, 0.40))])
    collar = [(0.068, -0.034), (0.068, 0.0045), (0.064, 0.0075), (0.059, 0.003), (0.054, -0.034)]
    cap = [(0.024, -0.033), (0.024, 0.016), (0.046, 0.024), (0.051, 0.029), (0.051, 0.036), (0.047, 0.040)]
    cap += [(0.041, 0.040), (0.034, 0.035), (0.016, 0.032)]
    for at, tilt in zip(sticks, ((0.0, 0.0), (0.12, -0.10)), strict=True):
        lean = Matrix.Rotation(tilt[0], 4, "X") @ Matrix.Rotation(tilt[1], 4, "Y")
        parts.add(_turned(cap, 24, start_cap=False), 7, at @ lean)
        parts.add(_turned(collar, 28, start_cap=False), [0] * 84 + [1] * 29, at)
    cross = [(0.0, -0.012), (0.0, 0.006), (0.004, 0.011), (0.008, 0.012)]
    parts.add(_cross(0.056, 0.019, cross), 1, pad)
    dome = [(0.0245, -0.02), (0.0245, 0.006), (0.0225, 0.011), (0.017, 0.0145), (0.008, 0.016)]
    for at, slot in zip(spots, (3, 4, 5, 6), strict=True):
        parts.add(_turned(dome, 16, start_cap=False), slot, at)
    parts.add(
        _turned([(0.026, -0.01), (0.026, 0.004), (0.023, 0.008), (0.010, 0.010)], 18, False), 0, on_face(0.0, 0.085)
    )
    parts.add(_turned([(0.033, -0.01), (0.033, 0.002)], 24, False), 6, on_face(0.0, 0.085))
    for sign in (-1, 1):
        pill = _slab(0.009, 0.020, 0.009, [(0.0, -0.01), (0.0, 0.003), (-0.003, 0.006)], 3, False)
        parts.add(pill, 1, on_face(sign * 0.115, 0.105) @ Matrix.Rotation(sign * -0.2, 4, "Z"))
        outward = Matrix.Rotation(-sign * 0.22, 4, "Z")
        bumper = Matrix.Translation((sign * 0.265, 0.178, 0.026)) @ outward
        parts.add(_pebble((0.112, 0.034, 0.020), 0.45), 0, bumper)
        trigger = Matrix.Translation((sign * 0.285, 0.172, -0.040)) @ outward @ Matrix.Rotation(0.45, 4, "X")
        parts.add(_pebble((0.078, 0.062, 0.034), 0.55), 2, trigger)
    parts.add(_studs(surface), 2)
    fittings = parts.link("controller_fittings")

    points = np.array([vertex.co for item in (skin, fittings) for vertex in item.data.vertices])
    placement = _controller_placement(points)
    for item in (skin, fittings):
        item.data.transform(placement)


def build() -> None:
    """Build the console and its controller in the current scene."""
    light = paint.plain("console_light_grey", paint.GREY, (0.40, 0.30))
    inside = paint.dark("console_inside", paint.INK, (0.55, 0.80))
    rubber = paint.dark("console_rubber", (0.035, 0.035, 0.037), (0.65, 0.85))
    red, yellow, green, blue, teal = (
        paint.plain(f"console_{name}", colour, (0.30, 0.45))
        for name, colour in (
            ("red", paint.RED),
            ("yellow", paint.YELLOW),
            ("green", paint.GREEN),
            ("blue", paint.BLUE),
            ("teal", paint.TEAL),
        )
    )
    _housing([paint.shell(CENTRE, HALF), inside, teal, paint.gloss(CENTRE, HALF)])
    _fittings(light, inside, rubber, [red, yellow, teal])
    _controller(light, inside, [red, yellow, green, blue])
