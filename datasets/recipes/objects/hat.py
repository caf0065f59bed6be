"""A straw sun hat with a printed grosgrain ribbon, resting tilted on a turned wooden hat block.

The straw is one braid sewn in a spiral from the top of the crown to the rim, and a second one under the brim: each
turn is a rounded ridge of the mesh, and the braid's strands are painted in the coordinates that the mesh carries as
the corner attribute 'chart' (length along the strip, position across it, a number that tells turns apart).
"""

from __future__ import annotations

import bpy
import numpy as np

from . import hat_paint as paints
from .forms import mesh_object, threads, tube
from .hat_form import (
    ARC,
    BAND_MIDDLE,
    EYE,
    OPENING,
    PITCH,
    RADIUS,
    RIM,
    TURNS,
    brim_height,
    charted,
    ribbon_strip,
    skin,
    surface,
    worn,
)

COLUMNS = 80  # vertices round the hat
RIDGE = 0.013  # height of a ridge
THICKNESS = 0.016  # of the straw, without the ridges
BOW = -0.95  # where the bow sits round the crown, radians
BAND = 0.062  # half the width of the ribbon


# ---------------------------------------------------------------- straw
def _smooth_random(rng: np.random.Generator, count: int, spacing: int) -> np.ndarray:
    """Draw normal deviates (count,) every `spacing` samples, linear between."""
    knots = np.arange(0, count + spacing, spacing)
    return np.interp(np.arange(count), knots, rng.normal(size=len(knots)))


def _braid(first: int, samples: np.ndarray, under: bool, paint: bpy.types.Material, rng: np.random.Generator) -> None:
    """One braid sewn in a spiral from turn `first` to the rim, on the outside or on the underside of the hat.

    `samples` are positions across one turn, from 0 to 1. The first and the last turn taper, so that the spiral begins
    and ends in a circle. Near the top of the crown only every second or fourth column is used.
    """
    last, start = COLUMNS * (TURNS - first + 1), EYE + PITCH * first
    k = np.arange(last + 1)
    inner = start + PITCH * np.maximum(k - COLUMNS, 0) / COLUMNS
    outer = np.minimum(start + PITCH * k / COLUMNS, RIM)
    width = outer - inner
    arc = inner[:, None] + width[:, None] * samples
    turn = 2.0 * np.pi * k / COLUMNS
    ends = (np.abs(arc - start) < 0.5 * PITCH) | (np.abs(arc - RIM) < 0.5 * PITCH)  # both end circles stay exact
    arc = arc + 0.0016 * ~ends * _smooth_random(rng, last + 1, 5)[:, None]
    height = RIDGE * width / PITCH * (1.0 + 0.16 * _smooth_random(rng, last + 1, 7))
    ridge = height[:, None] * np.sin(np.pi * samples) ** 0.7
    points = surface(arc, turn[:, None], -THICKNESS - ridge if under else ridge)
    count = len(samples) - 1

    def vertex(column: int, m: int) -> int:
        if column in (0, last):  # the tapered ends of the braid are points
            column, m = (COLUMNS, 0) if column == 0 else (last, 0)
        elif m == count and column + COLUMNS <= last:  # sewn to the next turn
            column, m = column + COLUMNS, 0
        return column * (count + 1) + m

    def stride(column: int) -> int:
        turns = column // COLUMNS + first
        return 4 if turns < 2 else 2 if turns < 5 else 1

    radius = np.interp(inner, ARC, RADIUS)
    length = np.concatenate([[0.0], np.cumsum(2.0 * np.pi / COLUMNS * radius[:-1])])
    faces, charts = [], []
    for column in range(last):
        if column % stride(column):
            continue
        following = column + stride(column)
        for m in range(count):
            next_stride = stride(column + COLUMNS) if m == count - 1 else stride(column)
            far = range(following, column - 1, -next_stride)
            outline = [(column, m), (following, m), *((c, m + 1) for c in far)][:: 1 if under else -1]
            face, chart = [], []
            for c, sample in outline:
                index = vertex(c, sample)
                if index not in face:
                    face.append(index)
                    chart.append((length[c], samples[sample], column // COLUMNS + 100.0 * under + 1.0))
            if len(face) > 2:
                faces.append(face)
                charts.append(chart)
    used = np.unique(np.concatenate([np.array(face) for face in faces]))
    position = {int(old): new for new, old in enumerate(used)}
    faces = [[position[index] for index in face] for face in faces]
    charted("braid_under" if under else "braid", points.reshape(-1, 3)[used], faces, charts, paint, 32.0)


def _eye(paint: bpy.types.Material) -> None:
    """Button of straw in which the spiral starts."""
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    rings = np.stack([surface(arc, angles, lift) for arc, lift in ((0.032, 0.0), (0.026, 0.013), (0.012, 0.018))])
    across = np.linspace(0.0, 0.11, 13)
    chart = np.stack([np.stack([across, np.full(13, v), np.zeros(13)], axis=-1) for v in (0.1, 0.4, 0.6)])
    skin("eye", rings, chart, paint)


def _frays(paint: bpy.types.Material, rng: np.random.Generator, count: int = 56) -> None:
    """Loose ends of straw that stick out of the seams, most of them near the rim."""
    vertices, faces = [], []
    section = np.array([(1.0, 0.0, 0.0), (-0.5, 0.87, 0.0), (-0.5, -0.5, 0.87)])
    for i in range(count):
        arc = EYE + PITCH * (TURNS - 1.2 - rng.integers(0, TURNS - 6) * rng.uniform())
        angle = rng.uniform(0.0, 2.0 * np.pi)
        forward, sideways, lift = rng.uniform(0.01, 0.06), rng.uniform(-0.11, 0.11), rng.uniform(0.022, 0.05)
        steps = np.array([0.0, 0.5, 1.0])
        swing = sideways / float(np.interp(arc, ARC, RADIUS))
        path = surface(arc + forward * steps, angle + swing * steps, lift * steps**0.8 + 0.002)
        for centre, radius in zip(path[:2], (0.0048, 0.0036), strict=True):
            vertices += list(centre + radius * section)
        vertices.append(path[2])
        base = 7 * i
        for j in range(3):
            k = (j + 1) % 3
            faces += [[base + j, base + k, base + 3 + k, base + 3 + j], [base + 3 + j, base + 3 + k, base + 6]]
    mesh_object("frays", worn(np.array(vertices)), faces, paint, 50.0)


# ---------------------------------------------------------------- cloth
def _hem(cloth: bpy.types.Material, thread: bpy.types.Material) -> None:
    """Binding folded round the rim and the stitches that hold it."""
    angles = np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False)
    section = np.array([
        (-0.044, -0.020), (-0.036, -0.035), (-0.010, -0.037), (0.008, -0.026), (0.014, -0.008), (0.008, 0.012),
        (-0.010, 0.021), (-0.036, 0.019), (-0.044, 0.004),
    ])  # fmt: skip
    pucker = 1.0 + 0.08 * np.sin(48.0 * angles) * np.sin(7.0 * angles)
    rings = np.stack([surface(RIM + inward * pucker, angles, lift * pucker) for inward, lift in section])
    along = np.linspace(0.0, 5.9, COLUMNS + 1)
    across = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(section, axis=0), axis=1))])
    chart = np.stack([*np.meshgrid(along, across), np.zeros((len(section), COLUMNS + 1))], axis=-1)
    skin("hem", rings, chart, cloth, caps=False, sharp=90.0)

    count, spines, sections = 92, [], []
    for i in range(count):
        middle = 2.0 * np.pi * i / count
        at = middle + np.array([-0.019, -0.012, 0.012, 0.019])
        spines.append(surface(RIM - 0.025, at, np.array([0.016, 0.0205, 0.0205, 0.016])))
        outward = np.array([np.cos(middle), np.sin(middle), 0.0])
        sections.append([0.0055 * outward, np.array([0.0, 0.0, 0.0055]), -0.0055 * outward])
    vertices, faces = threads(np.array(spines), np.array(sections))
    mesh_object("stitches", worn(vertices), faces, thread, 70.0)


def _band(paint: bpy.types.Material) -> None:
    """Ribbon round the crown; its edges end in the straw."""
    angles = np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False)
    across = np.array([1.0, 1.0, 0.93, 0.4, -0.4, -0.93, -1.0, -1.0]) * BAND
    lifts = np.array([0.0, 0.017, 0.0225, 0.021, 0.021, 0.0225, 0.017, 0.0])
    sag = 0.004 * np.sin(2.0 * angles + 1.0) + 0.002 * np.sin(7.0 * angles)
    rings = np.stack([surface(BAND_MIDDLE + a + sag, angles, lift) for a, lift in zip(across, lifts, strict=True)])
    along = np.linspace(0.0, 2.4, COLUMNS + 1)  # twenty whole prints
    chart = np.stack([*np.meshgrid(along, across), np.zeros((len(across), COLUMNS + 1))], axis=-1)
    skin("band", rings, chart, paint, caps=False)


def _bow(paint: bpy.types.Material) -> None:
    """Two gathered loops, two tails on the brim with swallow-tail ends, and the knot over them."""
    origin = surface(BAND_MIDDLE, BOW, 0.03)
    out = surface(BAND_MIDDLE, BOW, 1.03) - origin
    side = np.cross((0.0, 0.0, 1.0), out)
    side /= np.linalg.norm(side)
    up = np.cross(out, side)
    across = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    w = np.linspace(0.0, 1.0, 23)[:, None]
    full = np.sin(np.pi * w)
    for hand in (-1.0, 1.0):
        reach = (0.31 if hand > 0 else 0.285) * full**0.9
        gather = 0.011 * np.cos(1.5 * np.pi * across) * (1.0 - full)
        depth = 0.020 + 0.035 * full - 0.078 * np.sin(2.0 * np.pi * w) * full**0.3 - 0.62 * reach**2 + gather
        half = (0.026 + 0.062 * full**0.8) * across
        rise = (0.085 if hand > 0 else 0.045) * full**1.5 + half * (1.0 + 0.10 * full * across)
        points = origin + reach[..., None] * hand * side + depth[..., None] * out + rise[..., None] * up
        ribbon_strip("loop", points, paint, BAND * across)
    for hand in (-1.0, 1.0):
        length = 0.40 if hand > 0 else 0.33
        v = np.linspace(0.0, 1.0, 17)[:, None] * (1.0 - 0.16 * (1.0 - np.abs(across)))
        sideways = hand * (0.015 + 0.30 * v**1.15)
        outward = 0.015 + length * v - 0.06 * v**2
        heading = np.stack([hand * 0.34 * (v + 0.05) ** 0.15, length - 0.12 * v], axis=-1)
        heading /= np.linalg.norm(heading, axis=-1, keepdims=True)
        half = (0.026 + 0.040 * np.clip(v / 0.3, 0.0, 1.0) ** 0.8) * across
        sideways, outward = sideways + half * heading[..., 1], outward - half * heading[..., 0]
        level = out * (1.0, 1.0, 0.0) / np.hypot(out[0], out[1])
        plan = origin + sideways[..., None] * side + outward[..., None] * level
        ripple = 0.013 * (1.0 + np.sin(15.0 * v + 1.5 * hand + 0.8 * across)) * np.clip(v / 0.4, 0.0, 1.0)
        rest = brim_height(plan[..., 0], plan[..., 1]) + 0.021 + ripple
        fall = 1.0 - np.clip(v / 0.34, 0.0, 1.0)
        plan[..., 2] = rest + np.maximum(origin[2] - 0.02 - rest, 0.0) * fall**2 * (3.0 - 2.0 * fall)
        ribbon_strip("tail", plan, paint, BAND * across, 0.009)

    height = np.array([-0.062, -0.060, -0.045, -0.02, 0.02, 0.045, 0.060, 0.062])
    bulge = np.array([0.55, 0.85, 1.0, 0.95, 0.95, 1.0, 0.85, 0.55])
    turn = np.linspace(0.0, 2.0 * np.pi, 14, endpoint=False)
    pleat = 1.0 + 0.07 * np.cos(5.0 * turn)[None, :]
    ring = bulge[:, None] * pleat
    points = (
        origin + 0.012 * out + (0.043 * ring * np.cos(turn))[..., None] * side
        - (0.040 * ring * np.sin(turn))[..., None] * out + height[:, None, None] * up
    )  # fmt: skip
    chart = np.stack([*np.meshgrid(np.linspace(0.05, 0.35, 15), height), np.zeros((8, 15))], axis=-1)
    skin("knot", points, chart[..., [1, 0, 2]] * (1.0, 0.15, 1.0), paint, sharp=60.0)


# ---------------------------------------------------------------- the hat block
def _block(paint: bpy.types.Material, steps: int = 44) -> None:
    """Oval head that fills the opening of the hat, tilted with it, on a turned foot."""
    angles = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    head = np.array([
        (0.09, -0.185), (0.16, -0.175), (0.24, -0.150), (0.31, -0.110), (0.345, -0.070), (0.362, -0.045),
        (0.366, -0.036), (0.358, -0.030), (0.358, -0.024), (0.370, -0.016), (0.376, 0.03), (0.380, 0.115),
    ])  # fmt: skip
    rings = np.stack([np.column_stack([r * circle * (1.06, 0.94), np.full(steps, z)]) for r, z in head])
    foot = np.array([
        (0.30, -0.610), (0.36, -0.622), (0.42, -0.620), (0.442, -0.606), (0.448, -0.585), (0.440, -0.562),
        (0.420, -0.550), (0.402, -0.547), (0.398, -0.538), (0.385, -0.528), (0.33, -0.515), (0.24, -0.492),
        (0.16, -0.452), (0.112, -0.400), (0.092, -0.345), (0.088, -0.318), (0.098, -0.310), (0.124, -0.302),
        (0.134, -0.284), (0.126, -0.266), (0.100, -0.257), (0.090, -0.247), (0.092, -0.200), (0.115, -0.140),
        (0.17, -0.085),
    ])  # fmt: skip
    turned = np.stack([np.column_stack([r * circle, np.full(steps, z)]) for r, z in foot])
    for name, points, posed in (("head", rings, worn), ("foot", turned, np.asarray)):
        faces = [*tube(len(points), steps), range(steps)[::-1]]
        mesh_object(name, posed(points.reshape(-1, 3)), faces, paint, 42.0)


def build() -> None:
    """Build the hat on its block in the current scene."""
    rng = np.random.default_rng(7)
    straw, ribbon = paints.straw(), paints.grosgrain()
    _braid(0, np.array([0.0, 0.28, 0.70, 1.0]), False, straw, rng)
    _braid(int((OPENING - EYE) / PITCH) - 1, np.array([0.0, 0.5, 1.0]), True, straw, rng)
    _eye(straw)
    _frays(paints.loose_straw(), rng)
    _hem(paints.twill(), paints.thread())
    _band(ribbon)
    _bow(ribbon)
    _block(paints.walnut())
