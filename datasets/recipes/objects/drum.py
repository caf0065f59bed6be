"""A goblet drum: carved and painted wood, a goat skin, rope laced between wrapped rings, a leather strap, cowries.

Much of it is thin: one endless twisted rope stands off the bowl and throws its shadow on painted ornament whose white and
black teeth look like shadows themselves. The strap hangs at +x, +y, the cowries at -y; two beaters lie on the skin.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import drum_paint as paints
from .drum_paint import BOWL_BAND, COLLAR, FOOT_BAND, FOOT_MOTIFS, STEM_BAND, STEM_MOTIFS
from .forms import cells, frame, grid_surface, lathe, mesh_object, sheet, smooth_path, store_chart, threads, tube_along_curve

TAU = 2.0 * np.pi
COLUMNS = 60  # vertices round the shell
BARE = 0.3  # relief of wood without ornament; 0 is the bottom of a groove, 1 the highest ridge
HOLLOW = [(0.13, -0.46), (0.19, -0.62), (0.24, -0.78), (0.275, -0.885), (0.290, -0.903), (0.315, -0.905)]
"""Inside of the foot, (radius, height)."""

OUTSIDE = smooth_path([
    (0.336, 0.0, -0.895), (0.320, 0.0, -0.80), (0.277, 0.0, -0.66), (0.226, 0.0, -0.51), (0.197, 0.0, -0.37),
    (0.186, 0.0, -0.27), (0.194, 0.0, -0.19), (0.235, 0.0, -0.13), (0.305, 0.0, 0.00), (0.356, 0.0, 0.10),
    (0.405, 0.0, 0.20), (0.447, 0.0, 0.30), (0.481, 0.0, 0.40), (0.504, 0.0, 0.50), (0.514, 0.0, 0.60), (0.514, 0.0, 0.72),
], 300)[:, [0, 2]]  # fmt: skip
"""Section of the shell without its carving, (radius, height) from the foot up."""

SKIN = 0.009  # thickness of the skin
CROWN, FLESH, LOWER = (0.548, 0.535, 0.028), (0.548, 0.617, 0.024), (0.261, -0.130, 0.026)
"""The rings: radius about the axis, height, radius of their section."""

TOPS = 12  # bights of the lacing over the crown ring
ROPE = 0.0145  # its radius
KNOT = 0.035  # height of the row of knots
STRAP = np.radians(45.0)  # where the strap hangs


def build() -> None:
    """Build the drum in the empty scene, within the unit sphere."""
    wood, leather = paints.turned_wood(), paints.leather()
    cord = paints.rope("cord", (0.34, 0.095, 0.05), (0.17, 0.04, 0.03))
    _shell(paints.shell(), paints.goat_skin())
    _ring("crown ring", CROWN, 78, paints.wrapping("red cloth", (0.42, 0.045, 0.035), (0.045, 0.06, 0.17), (0.78, 0.66, 0.38)))
    _ring("flesh ring", FLESH, 76, paints.wrapping("blue cloth", (0.04, 0.13, 0.30), (0.62, 0.36, 0.07), (0.80, 0.75, 0.64)))
    _ring("lower ring", LOWER, 48, paints.wrapping("green cloth", (0.06, 0.17, 0.09), (0.66, 0.43, 0.09), (0.70, 0.10, 0.05)))
    _lacing(paints.rope("rope", (0.72, 0.62, 0.43), (0.50, 0.39, 0.23), (0.13, 0.075, 0.05)))
    _knots(cord)
    _belt(leather)
    _strap(leather, paints.thread())
    _toggle(wood)
    _cowries(paints.cowrie(), paints.rope("dark cord", (0.12, 0.08, 0.055), (0.06, 0.042, 0.035)))
    _beaters(wood, paints.wound_yarn())


# ---------------------------------------------------------------- helpers
def radius_at(height: np.ndarray | float) -> np.ndarray:
    """Radius of the shell without its carving."""
    return np.interp(height, OUTSIDE[:, 1], OUTSIDE[:, 0])


def polar(radius: np.ndarray | float, angle: np.ndarray | float, height: np.ndarray | float) -> np.ndarray:
    """Points (..., 3) from cylindrical coordinates."""
    radius, angle, height = np.broadcast_arrays(radius, angle, height)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)


def endless(name: str, rings: np.ndarray, material: bpy.types.Material, length: float, sharp_deg: float = 180.0) -> None:
    """Tube that closes on itself, through `rings` (rows, columns, 3) ordered as for `grid_surface`.

    The attribute 'chart' holds the fraction round the section and the distance along, up to `length`.
    """
    rows, columns, _ = rings.shape
    index = np.pad(np.arange(rows * columns).reshape(rows, columns), (0, 1), "wrap")
    item = mesh_object(name, rings.reshape(-1, 3), cells(index).tolist(), material, sharp_deg)
    v, u = np.meshgrid(np.arange(rows + 1) / rows * length, np.arange(columns + 1) / columns, indexing="ij")
    store_chart(item, cells(np.stack([u, v, 0.0 * u], axis=-1)))


def sections(path: np.ndarray, aside: np.ndarray, radius: float, twist: np.ndarray, sides: int) -> np.ndarray:
    """Rings (n, sides, 3) round a closed path (n, 3), turned by `twist` (n,) from the directions `aside` (n, 3)."""
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = aside - ahead * np.sum(aside * ahead, axis=1, keepdims=True)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angle = (twist[:, None] + np.linspace(0.0, TAU, sides, endpoint=False))[..., None]
    other = np.cross(ahead, aside)
    return path[:, None] + radius * (np.cos(angle) * aside[:, None] + np.sin(angle) * other[:, None])


# ---------------------------------------------------------------- shell and skin
def _carving(turn: np.ndarray, z: float) -> np.ndarray:
    """Relief in [0, 1] at a height: a zigzag on the foot, pyramids on the stem, bare wood elsewhere."""
    for kind, (low, high), motifs in (("zigzag", FOOT_BAND, FOOT_MOTIFS), ("pyramid", STEM_BAND, STEM_MOTIFS)):
        if low - 1e-6 <= z <= high + 1e-6:
            v, tooth = (z - low) / (high - low), np.abs(turn * motifs % 1.0 * 2.0 - 1.0)
            raised = 1.0 - 2.0 * np.abs(tooth - v) if kind == "zigzag" else 1.0 - tooth - np.abs(2.0 * v - 1.0)
            return 0.2 + 0.8 * np.clip(raised, 0.0, 1.0)
    return np.full_like(turn, BARE)


def _shell(wood: bpy.types.Material, skin: bpy.types.Material) -> None:
    """Hollow foot, carved outside and skin as one closed surface; the skin is glued over the upper edge."""
    turn = np.linspace(0.0, 1.0, COLUMNS + 1)
    around = TAU * turn
    rows, charts = [], []

    def add(radius: np.ndarray | float, z: np.ndarray | float, relief: np.ndarray | float = BARE, inside: float = 0.0) -> None:
        rows.append(polar(radius, around[:-1], z))
        charts.append(np.stack(np.broadcast_arrays(turn, relief, inside), axis=-1))

    for radius, z in HOLLOW:
        add(radius, z, inside=1.0 if z > -0.9 else 0.0)
    add(0.334, -0.895)
    lines = [FOOT_BAND[0] - 0.022, FOOT_BAND[1] + 0.022, STEM_BAND[0] - 0.022, STEM_BAND[1] + 0.022]
    bands = [*np.linspace(*FOOT_BAND, 5), *np.linspace(*STEM_BAND, 5), *BOWL_BAND]
    plain = [-0.878, -0.61, -0.565, -0.315, -0.265, -0.170, -0.11, -0.03, 0.07, 0.15, 0.29, 0.42]
    grooves = [(z + step, 0.012 * (step == 0), BARE * (step != 0)) for z in lines for step in (-0.009, 0.0, 0.009)]
    middle = 0.5 * (COLLAR[0] + COLLAR[1])
    moulding = [(middle + s * 0.024, -0.022 * np.sqrt(1.0 - s * s), 0.5) for s in (-1.0, -0.7, 0.0, 0.7, 1.0)]
    adze = 0.0022 * np.sin(9 * around[:-1] + 1.0) + 0.0016 * np.sin(14 * around[:-1])
    for z, depth, flat in sorted([*((z, 0.0, BARE) for z in (*bands, *plain)), *grooves, *moulding]):
        relief = _carving(turn, z) if flat == BARE else np.full_like(turn, flat)
        add(radius_at(z) - depth + 0.014 * (relief[:-1] - BARE) + adze * np.sin(23 * z), z, relief)
    wooden = len(rows)

    hem = 0.474 + 0.010 * np.sin(5 * around[:-1] + 1.0) + 0.006 * np.sin(13 * around[:-1])  # cut by eye
    add(radius_at(hem) + 0.0005, hem)
    add(radius_at(hem) + SKIN, hem + 0.003)
    for z in (0.535, 0.617, 0.680):
        add(radius_at(z) + SKIN, z)
    for radius, z in ((0.519, 0.705), (0.508, 0.721), (0.488, 0.729), (0.455, 0.729)):
        add(radius, z)
    for radius in (0.38, 0.27, 0.15, 0.05):
        add(radius, 0.726 + 0.0015 * np.sin(3 * around[:-1] + 9 * radius))
    item = grid_surface("shell", np.array(rows), wood, np.array(charts), 50.0)
    item.data.materials.append(skin)
    # Faces run row by row; of the two fans at the end, first bottom and top alternate.
    ring = np.arange(len(rows) - 1) >= wooden - 1
    item.data.polygons.foreach_set("material_index", [*np.repeat(ring, COLUMNS).astype(int), *([0, 1] * COLUMNS)])


# ---------------------------------------------------------------- rings and ropes
def _ring(name: str, size: tuple[float, float, float], count: int, cloth: bpy.types.Material) -> None:
    """Ring of twisted grass wound with cloth: every second section is thinner, where a turn ends."""
    radius, height, thick = size
    around = np.linspace(0.0, TAU, count, endpoint=False)
    path = polar(radius, around, height)
    rings = sections(path, polar(1.0, around, 0.0), 1.0, 0.0 * around, 7)
    swell = np.where(np.arange(count) % 2, 1.02, 0.92) + 0.03 * np.sin(3 * around) * np.sin(7 * around + 1.0)
    rings = path[:, None] + thick * swell[:, None, None] * (rings - path[:, None])
    turns = 0.095 * round(TAU * radius / 0.095)  # whole turns of the winding that `wrapping` paints
    endless(name, rings, cloth, turns)


def _lacing_path(step: float) -> np.ndarray:
    """Closed path (n, 3) up and down between the rings: over the crown ring, under the lower one, gathered at the knots."""
    outer, bottom = CROWN[0] + CROWN[2] + ROPE, LOWER[0] + LOWER[2] + ROPE
    gathered = bottom + (outer - bottom) * (KNOT - LOWER[1]) / (CROWN[1] - LOWER[1])
    corners = []
    for i in range(TOPS):
        top, low = TAU * i / TOPS, TAU * (i + 0.5) / TOPS
        over, under, pinch = 0.042, 0.075, 0.019 / gathered
        corners += [(outer, top - over, CROWN[1]), (0.556, top, 0.583), (outer, top + over, CROWN[1])]
        corners += [(gathered, low - pinch, KNOT), (bottom, low - under, LOWER[1]), (0.262, low, -0.177)]
        corners += [(bottom, low + under, LOWER[1]), (gathered, low + pinch, KNOT)]
    points = polar(*np.array(corners).T)

    def along(line: np.ndarray, spacing: float) -> np.ndarray:
        line = np.concatenate([line, line[:1]])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.linspace(0.0, length[-1], round(length[-1] / spacing), endpoint=False)
        return np.stack([np.interp(at, length, axis) for axis in line.T], axis=-1)

    fine = along(points, 0.003)
    frequency = np.fft.rfftfreq(len(fine), 0.003)
    rounded = np.exp(-2.0 * (np.pi * 0.011 * frequency) ** 2)[:, None]  # a rope bends in no corner: Gaussian of .011
    return along(np.fft.irfft(np.fft.rfft(fine, axis=0) * rounded, len(fine), axis=0), step)


def _lacing(rope: bpy.types.Material) -> None:
    """One endless rope of four strands: a square section that turns along the way."""
    step = 0.0203
    path = _lacing_path(step)
    twist = np.linspace(0.0, TAU * round(len(path) / 9), len(path), endpoint=False)  # 40 degrees a section
    endless("lacing", sections(path, path * (1.0, 1.0, 0.0), ROPE, twist, 4), rope, step * len(path))


def _knots(cord: bpy.types.Material) -> None:
    """Row of whippings that pull the two legs over each bight together."""
    slope = (CROWN[0] - LOWER[0]) / (CROWN[1] - LOWER[1])
    radius = LOWER[0] + LOWER[2] + ROPE + slope * (KNOT - LOWER[1])
    phase = np.linspace(-0.3, 2.2, 19) * TAU
    for i in range(TOPS):
        low = TAU * (i + 0.5) / TOPS
        side, out, up = polar(1.0, low + np.pi / 2, 0.0), polar(1.0, low, -slope), polar(slope, low, 1.0)
        out, up = out / np.linalg.norm(out), up / np.linalg.norm(up)
        rise = (phase / TAU - 0.95) * 0.021
        path = polar(radius, low, KNOT) + 0.039 * np.cos(phase)[:, None] * side - 0.024 * np.sin(phase)[:, None] * out
        tube_along_curve("knot", path + rise[:, None] * up, np.full(len(phase), 0.0115), cord, 4)


# ---------------------------------------------------------------- leather
def _belt(leather: bpy.types.Material) -> None:
    """Leather band round the stem."""
    around = np.linspace(0.0, TAU, 36, endpoint=False)
    section = [(-0.004, 0.030), (0.012, 0.031), (0.018, 0.024), (0.018, -0.024), (0.012, -0.031), (-0.004, -0.030)]
    rings = np.array([polar(radius_at(-0.315 + z) + r, around, -0.315 + z) for r, z in section])
    endless("belt", rings.transpose(1, 0, 2), leather, TAU * 0.2, 50.0)


def _strap(leather: bpy.types.Material, thread: bpy.types.Material) -> None:
    """Strap from behind the flesh ring over both rings, down in a slack bow, up again to the belt; stitched along its edges."""
    line = [(0.523, 0.628), (0.545, 0.655), (0.584, 0.632), (0.594, 0.540), (0.612, 0.45), (0.634, 0.30), (0.622, 0.10)]
    line += [(0.565, -0.12), (0.455, -0.30), (0.345, -0.385), (0.265, -0.385), (0.224, -0.345), (0.214, -0.300), (0.214, -0.272)]
    path = smooth_path(polar(np.array(line)[:, 0], STRAP, np.array(line)[:, 1]), 36)
    s = np.linspace(0.0, 1.0, len(path))
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    level = polar(1.0, STRAP + np.pi / 2, 0.0)
    slack = np.sin(np.pi * np.clip((s - 0.2) / 0.65, 0.0, 1.0))[:, None]
    wide = level * np.cos(0.30 * slack) + np.cross(ahead, level) * np.sin(0.30 * slack)
    face = np.cross(ahead, wide)
    path = path + 0.03 * slack**2 * level
    across, half = np.array([-1.0, -0.6, 0.6, 1.0]), 0.037 - 0.006 * s[:, None, None]
    bulge = 0.004 * (1.0 - across**2)[None, :, None]
    sheet("strap", path[:, None] + half * across[:, None] * wide[:, None] + bulge * face[:, None], leather, 0.014)

    spines, sections = [], []
    for middle in np.linspace(0.12, 0.97, 26):
        for hand in (-0.74, 0.74):
            w = middle + np.array([-0.008, -0.005, 0.005, 0.008])
            p, e, f, d = (np.stack([np.interp(w, s, axis) for axis in v.T], axis=-1) for v in (path, wide, face, ahead))
            spine = p + (0.037 - 0.006 * middle) * hand * e + np.array([0.006, 0.0105, 0.0105, 0.006])[:, None] * f
            spines.append(spine + hand * 0.004 * d * np.array([-1.0, -0.5, 0.5, 1.0])[:, None])
            sections.append([-0.0042 * e[1], 0.0042 * f[1], 0.0042 * e[1]])
    mesh_object("stitches", *threads(np.array(spines), np.array(sections)), thread, 70.0)


def _toggle(wood: bpy.types.Material) -> None:
    """Wooden button that holds the strap on the belt."""
    profile = [(0.0, -0.012), (0.020, -0.012), (0.025, -0.002), (0.022, 0.010), (0.011, 0.0155), (0.0, 0.0135)]
    lathe("toggle", profile, wood, 10, polar(0.232, STRAP, -0.318), polar(1.0, STRAP, 0.0))


# ---------------------------------------------------------------- shells on a cord
def _cowries(shell: bpy.types.Material, cord: bpy.types.Material) -> None:
    """Seven cowries on a cord that hangs before the lacing, some with their back to the front."""
    s = np.linspace(0.0, 1.0, 40)
    slope = (CROWN[0] - LOWER[0]) / (CROWN[1] - LOWER[1])

    def hang(at: np.ndarray | float, off: float) -> np.ndarray:
        height = 0.525 - 0.33 * (1.0 - (2.0 * np.asarray(at) - 1.0) ** 2)
        outer = CROWN[0] + CROWN[2] + ROPE + slope * (height - CROWN[1])
        return polar(outer + off, np.radians(-132.0) + np.radians(84.0) * np.asarray(at), height)

    line = hang(s, 0.022)
    line[[0, -1]] *= (0.97, 0.97, 1.0)  # the ends are tucked behind the crown ring
    tube_along_curve("cord", line, np.full(len(s), 0.0085), cord, 5)
    angle = np.linspace(0.0, TAU, 11)
    height = np.array([-0.97, -0.80, -0.45, 0.0, 0.45, 0.80, 0.97])
    ring = np.sqrt(1.0 - height**2)[:, None]
    depth = np.where(np.sin(angle) < 0.0, 0.62, 1.0) * np.sin(angle)  # a flat belly
    unit = np.stack(
        np.broadcast_arrays(ring * np.cos(angle) * (1.0 - 0.18 * height[:, None]), -height[:, None], ring * depth), axis=-1
    )
    for k, (at, lean) in enumerate(zip((0.13, 0.255, 0.38, 0.5, 0.62, 0.745, 0.87), (9, -6, 14, -3, -12, 7, -9), strict=True)):
        pose = np.array(frame(hang(at, 0.040) - (0.0, 0.0, 0.028), polar(1.0, np.arctan2(*hang(at, 0.0)[1::-1]), -slope)))
        if k % 3:  # slit to the front
            pose[:3, :3] = pose[:3, :3] @ np.diag((-1.0, 1.0, -1.0))
        lean_by = np.radians(lean)
        turn = np.array([[np.cos(lean_by), -np.sin(lean_by), 0], [np.sin(lean_by), np.cos(lean_by), 0], [0, 0, 1]])
        points = unit[:, :-1] * (0.030, 0.043, 0.024) @ (pose[:3, :3] @ turn).T + pose[:3, 3]
        grid_surface("cowrie", points, shell, unit)


# ---------------------------------------------------------------- beaters
def _beaters(wood: bpy.types.Material, wool: bpy.types.Material) -> None:
    """Two beaters on the skin, the second resting on the first, their heads wound with yarn."""
    for head, tail in (((0.20, 0.24, 0.786), (-0.28, -0.40, 0.746)), ((0.31, 0.00, 0.786), (-0.44, -0.22, 0.822))):
        start, end = np.array(head), np.array(tail)
        path = start + np.linspace(0.0, 1.0, 11)[:, None] * (end - start)
        path = np.concatenate([path, path[-1:] + 0.006 * (end - start)])
        radii = np.array([0.012, 0.012, 0.0125, 0.013, 0.0135, 0.014, 0.0145, 0.015, 0.0155, 0.017, 0.020, 0.012])
        tube_along_curve("beater", path, radii, wood, 8)
        thick = np.array([0.012, 0.034, 0.046, 0.0535, 0.055, 0.053, 0.046, 0.035, 0.022, 0.017])
        axis = (end - start) / np.linalg.norm(end - start)
        winding = thick[:, None] * (1.0 + 0.03 * np.where(np.arange(10) % 2, 1.0, -1.0))[:, None]
        tube_along_curve("head", start + np.linspace(-0.053, 0.066, 10)[:, None] * axis, winding * np.ones(11), wool, 11)
