"""Procedural objects: random assemblies of building blocks, each part with a material slot of its own.

Object space is z up; the finished object is centred and fits the unit ball.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ia_bench_training import primitives
from ia_bench_training.draws import about_z, pick, rotation
from ia_bench_training.surfaces import Surface, corner_normals, face_normals, rounded_box, sweep

MAX_TRIANGLES = 24_000
MAX_SLOTS = 5
"""Materials of an object at most."""


@dataclass(frozen=True)
class SolidObject:
    """A finished object of F triangles.

    Attributes:
        vertices: (V, 3) float32.
        faces: (F, 3) int32.
        normals: (F, 3, 3), the shading normal of each triangle's corners.
        local: (F, 3, 3), where each corner was in its part before the part was posed.
        slot: (F,) int64, the material of each triangle, below ``slots``.
        axis: (F,) int64, the dominant axis of each triangle's normal in its part.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    local: np.ndarray
    slot: np.ndarray
    axis: np.ndarray
    slots: int


@dataclass
class _Part:
    surface: Surface
    local: np.ndarray
    slot: int
    crease: float


class Assembly:
    """Parts put together so far."""

    def __init__(self, rng: Generator) -> None:
        self.rng = rng
        self.parts: list[_Part] = []
        self.slots = 0
        self._reuse = rng.uniform(0.1, 0.6)

    def slot(self) -> int:
        """A material: a new one, or one that is in use already."""
        if self.slots and (self.slots == MAX_SLOTS or self.rng.random() < self._reuse):
            return int(self.rng.integers(0, self.slots))
        self.slots += 1
        return self.slots - 1

    def add(
        self,
        surface: Surface,
        slot: int,
        *,
        scale: float | np.ndarray = 1.0,
        turn: np.ndarray | None = None,
        move: np.ndarray | tuple[float, float, float] = (0, 0, 0),
    ) -> Surface:
        """Scale, turn and move a building block into place; returns what was placed."""
        scale = np.broadcast_to(np.asarray(scale, np.float64), 3)
        turned = surface.vertices * scale @ (np.eye(3) if turn is None else turn).T
        placed = Surface(turned + np.asarray(move, np.float64), surface.faces)
        crease = math.radians(1.0 if self.rng.random() < 0.06 else 38.0)
        self.parts.append(_Part(placed, surface.vertices * scale / scale.max(), slot, crease))
        return placed


def tilt(rng: Generator, spread: float) -> np.ndarray:
    """A rotation around z, then a small one around a random axis (radians, standard deviation ``spread``)."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.normal(0, spread)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return (np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k) @ about_z(rng.uniform(0, 2 * math.pi))


def _upright(a: Assembly, surface: Surface) -> Surface:
    """Turn a block by a random choice of axis permutation, so that any of its sides may be up."""
    order = a.rng.permutation(3)
    return Surface(surface.vertices[:, order], surface.faces)


def stack(a: Assembly) -> None:
    """Things on top of each other: totems, toys, cairns, lamps."""
    rng, level = a.rng, 0.0
    for _ in range(int(rng.integers(2, 7))):
        block = _upright(a, primitives.anything(rng)) if rng.random() < 0.7 else primitives.turned(rng)
        scale = rng.uniform(0.25, 1.0) * np.array([1, 1, rng.uniform(0.3, 1)])
        bottom = (block.vertices[:, 2] * scale[2]).min()
        turn = about_z(rng.uniform(0, 6.3))
        placed = a.add(block, a.slot(), scale=scale, turn=turn, move=(*rng.normal(0, 0.06, 2), level - bottom))
        level = placed.vertices[:, 2].max() - 0.02


def container(a: Assembly) -> None:
    """A vessel with handles, lid, spout, foot or contents."""
    rng = a.rng
    body = a.add(primitives.vessel(rng), a.slot())
    low, top = body.vertices[:, 2].min(), body.vertices[:, 2].max()
    rim = np.hypot(*body.vertices[body.vertices[:, 2] > top - 0.03][:, :2].T).max()
    wide = np.hypot(*body.vertices[:, :2].T).max()
    handles = int(rng.choice([0, 1, 1, 2]))
    slot = a.slot()
    angle, high = rng.uniform(0, 6.3), rng.uniform(0.25, 0.45) * (top - low)
    t = np.linspace(-1.35, 1.35, 24)
    for k in range(handles):
        arc = np.stack([wide * 0.85 + rng.uniform(0.35, 0.5) * np.cos(t), 0 * t, high * np.sin(t) + (low + top) / 2], -1)
        handle = sweep(arc, primitives.circle(10, rng.uniform(0.05, 0.1)))
        a.add(handle, slot, turn=about_z(angle + math.pi * k))
    if rng.random() < 0.35:  # lid with knob
        lid = primitives.quadric(rng) if rng.random() < 0.5 else primitives.plate(rng)
        a.add(lid, a.slot(), scale=np.array([rim, rim, 0.35]), move=(0, 0, top))
        a.add(primitives.turned(rng), slot, scale=0.18, move=(0, 0, top + 0.4))
    elif rng.random() < 0.6:  # contents
        slot = a.slot()
        for _ in range(int(rng.integers(1, 6))):
            place = (*rng.normal(0, 0.3 * rim, 2), top - rng.uniform(0, 0.4))
            own = slot if rng.random() < 0.5 else a.slot()
            a.add(primitives.anything(rng), own, scale=rng.uniform(0.2, 0.5) * rim, turn=rotation(rng), move=place)
    if rng.random() < 0.4:
        a.add(primitives.ring(rng), a.slot(), scale=np.array([wide, wide, 0.6]), move=(0, 0, rng.uniform(low, top)))


def furniture(a: Assembly) -> None:
    """A top on legs, with shelves, back or things on it: tables, stools, chairs, stands, racks."""
    rng = a.rng
    x, y, z = rng.uniform(0.5, 1.1), rng.uniform(0.4, 0.9), rng.uniform(0.4, 1.2)
    thick, wood = rng.uniform(0.03, 0.14), a.slot()
    slab = rounded_box(np.array([x, y, thick]), rng.uniform(0.01, thick), 3)
    for level in np.linspace(0, -1.6 * z, int(rng.choice([1, 1, 2, 3]))):
        a.add(slab, wood, move=(0, 0, level))
    leg_slot = a.slot()
    kind, slim = rng.integers(0, 3), rng.uniform(0.04, 0.13)
    leg = primitives.turned(rng) if kind else rounded_box(np.ones(3), 0.2, 2)
    leg = Surface(leg.vertices * [slim * 1.3, slim * 1.3, z], leg.faces)
    splay = rng.uniform(0, 0.2) * (rng.random() < 0.5)
    for sx in (-1, 1):
        for sy in (-1, 1):
            turn = np.array([[1, 0, -sx * splay], [0, 1, -sy * splay], [0, 0, 1.0]])
            a.add(leg, leg_slot, turn=turn, move=(sx * (x - 1.3 * slim), sy * (y - 1.3 * slim), -z))
    if rng.random() < 0.4:  # back
        slot = a.slot()
        for k in np.linspace(-1, 1, int(rng.integers(2, 7))):
            a.add(rounded_box(np.array([slim, slim, 0.5]), 0.02, 2), slot, move=(k * (x - slim), y - slim, 0.5))
        a.add(rounded_box(np.array([x, slim, 0.12]), 0.03, 2), slot, move=(0, y - slim, 1.0))
    if rng.random() < 0.6:
        for _ in range(int(rng.integers(1, 4))):
            block = _upright(a, primitives.anything(rng))
            scale = rng.uniform(0.2, 0.45)
            place = (rng.uniform(-0.7, 0.7) * x, rng.uniform(-0.7, 0.7) * y, thick - (block.vertices[:, 2] * scale).min())
            a.add(block, a.slot(), scale=scale, turn=about_z(rng.uniform(0, 6.3)), move=place)


def radial(a: Assembly) -> None:
    """A core with copies around it: flowers, wheels, crowns, chandeliers, carousels."""
    rng = a.rng
    core = primitives.SOLIDS[rng.integers(0, len(primitives.SOLIDS))](rng)
    a.add(core, a.slot(), scale=rng.uniform(0.25, 0.8))
    for _ in range(int(rng.integers(1, 4))):
        block, slot = primitives.anything(rng), a.slot()
        count, pose = int(rng.integers(3, 11)), rotation(rng) if rng.random() < 0.5 else np.eye(3)
        scale, out, level = rng.uniform(0.12, 0.5), rng.uniform(0.4, 1.0), rng.uniform(-0.5, 0.5)
        count = min(count, max(3, 9000 // len(block.faces)))
        for k in range(count):
            spin = about_z(2 * math.pi * k / count)
            a.add(block, slot, scale=scale, turn=spin @ pose, move=spin @ np.array([out, 0, level]))
    if rng.random() < 0.5:
        a.add(primitives.ring(rng), a.slot(), scale=rng.uniform(0.5, 1.0), move=(0, 0, rng.uniform(-0.4, 0.4)))


def cluster(a: Assembly) -> None:
    """Blocks grown into each other."""
    rng = a.rng
    for k in range(int(rng.integers(2, 8))):
        place = rng.normal(0, 0.45, 3) * (k > 0)
        a.add(primitives.anything(rng), a.slot(), scale=rng.uniform(0.3, 0.9), turn=rotation(rng), move=place)


def still_life(a: Assembly) -> None:
    """Several things on a base that they shade: trays, dioramas, boards, pedestals."""
    rng = a.rng
    half = np.array([1.1, rng.uniform(0.6, 1.1), rng.uniform(0.04, 0.25)])
    base = primitives.plate(rng) if rng.random() < 0.3 else rounded_box(half, 0.03, 2)
    top = a.add(base, a.slot()).vertices[:, 2].max()
    for _ in range(int(rng.integers(2, 8))):
        block = _upright(a, primitives.anything(rng))
        scale = rng.uniform(0.15, 0.55)
        lift = top - (block.vertices[:, 2] * scale).min() - 0.01
        a.add(block, a.slot(), scale=scale, turn=about_z(rng.uniform(0, 6.3)), move=(*rng.uniform(-0.7, 0.7, 2), lift))


def mirrored(a: Assembly) -> None:
    """A body with pairs of parts left and right: animals, robots, vehicles, headphones."""
    rng = a.rng
    body = primitives.SOLIDS[rng.integers(0, len(primitives.SOLIDS))](rng)
    a.add(body, a.slot(), scale=rng.uniform(0.4, 0.8) * np.array([1, rng.uniform(0.5, 1), rng.uniform(0.6, 1.2)]))
    for _ in range(int(rng.integers(1, 5))):
        block, slot = primitives.anything(rng), a.slot()
        pose, scale = (rotation(rng) if rng.random() < 0.6 else np.eye(3)), rng.uniform(0.1, 0.45)
        place = np.array([rng.uniform(0.2, 0.8), *rng.uniform(-0.8, 0.8, 2)])
        flip = np.diag([-1.0, 1, 1])
        a.add(block, slot, scale=scale, turn=pose, move=place)
        a.add(block, slot, scale=scale, turn=flip @ pose, move=flip @ place)
    for _ in range(int(rng.integers(0, 3))):  # on the middle plane
        place = np.array([0, *rng.uniform(-0.8, 0.8, 2)])
        a.add(_upright(a, primitives.anything(rng)), a.slot(), scale=rng.uniform(0.2, 0.5), move=place)


def architecture(a: Assembly) -> None:
    """Walls, columns, arches and steps."""
    rng, wall = a.rng, a.slot()
    levels = int(rng.integers(1, 4))
    width, floor = rng.uniform(0.6, 1.0), 0.0
    for _ in range(levels):
        height, other = rng.uniform(0.25, 0.6), rng.uniform(0.5, 1.0) * width
        a.add(rounded_box(np.array([width, other, 0.06]), 0.01, 1), a.slot(), move=(0, 0, floor))
        columns, slot = int(rng.integers(2, 6)), a.slot()
        post = primitives.turned(rng) if rng.random() < 0.4 else rounded_box(np.array([1.0, 1.0, 1.0]), 0.05, 1)
        slim = rng.uniform(0.05, 0.16)
        for sy in (-1, 1):
            for k in np.linspace(-1, 1, columns):
                place = (k * (width - slim), sy * (other - slim), floor + height)
                a.add(post, slot, scale=np.array([slim, slim, height]), move=place)
        if rng.random() < 0.6:
            a.add(rounded_box(np.array([width * 0.6, other * 0.6, height]), 0.02, 1), wall, move=(0, 0, floor + height))
        floor += 2 * height
        width *= rng.uniform(0.6, 1.0)
    roof = primitives.cone(rng) if rng.random() < 0.5 else rounded_box(np.array([1, 1, 0.1]), 0.02, 1)
    a.add(roof, a.slot(), scale=np.array([width * 1.1, width * 1.1, 0.5]), move=(0, 0, floor + 0.15))


def single(a: Assembly) -> None:
    """One block, perhaps with a second grown through it."""
    rng = a.rng
    family = (*primitives.SOLIDS, primitives.knot, primitives.carved, primitives.carved, primitives.lump)
    a.add(family[rng.integers(0, len(family))](rng), a.slot(), turn=rotation(rng) if rng.random() < 0.4 else None)
    if rng.random() < 0.4:
        a.add(primitives.anything(rng), a.slot(), scale=rng.uniform(0.3, 0.7), turn=rotation(rng), move=rng.normal(0, 0.3, 3))


def shelf(a: Assembly) -> None:
    """Rows of similar things in an open case: books, boxes, pipes, crates."""
    rng = a.rng
    x, y, z, thick = rng.uniform(0.6, 1), rng.uniform(0.25, 0.5), rng.uniform(0.5, 1.1), rng.uniform(0.02, 0.06)
    slot = a.slot()
    for sign in (-1, 1):
        a.add(rounded_box(np.array([thick, y, z]), 0.01, 1), slot, move=(sign * x, 0, 0))
    if rng.random() < 0.7:
        a.add(rounded_box(np.array([x, thick, z]), 0.01, 1), slot, move=(0, y, 0))
    boards = np.linspace(-z, z, int(rng.integers(2, 5)))
    for level in boards:
        a.add(rounded_box(np.array([x, y, thick]), 0.01, 1), slot, move=(0, 0, level))
    for low, high in zip(boards, boards[1:], strict=False):
        at = -x + thick
        while at < x - 0.2:
            size, tall = rng.uniform(0.03, 0.2), rng.uniform(0.4, 0.95) * (high - low) / 2
            if rng.random() < 0.8:
                block = rounded_box(np.array([1, 1, 1.0]), 0.08, 1) if rng.random() < 0.7 else primitives.anything(rng)
                scale = np.array([size, rng.uniform(0.5, 0.9) * y, tall])
                bottom = (block.vertices[:, 2] * tall).min()
                a.add(block, a.slot(), scale=scale, move=(at + size, rng.uniform(-0.2, 0.1) * y, low + thick - bottom))
            at += 2 * size + rng.uniform(0, 0.05)


ASSEMBLIES: tuple[tuple[Callable[[Assembly], None], float], ...] = (
    (stack, 1.3), (container, 1.3), (furniture, 1.0), (radial, 1.0), (cluster, 1.2), (still_life, 1.3), (mirrored, 1.2),
    (architecture, 0.6), (single, 1.2), (shelf, 0.5),
)  # fmt: skip


def make_object(rng: Generator) -> SolidObject:
    """Draw an object: an assembly, bent as a whole at times, centred in the unit ball."""
    while True:
        assembly = Assembly(rng)
        pick(rng, ASSEMBLIES)[0](assembly)
        if sum(len(part.surface.faces) for part in assembly.parts) <= MAX_TRIANGLES:
            return _finish(assembly)


def _finish(a: Assembly) -> SolidObject:
    rng = a.rng
    every = np.concatenate([part.surface.vertices for part in a.parts])
    centre, reach = (every.min(0) + every.max(0)) / 2, np.ptp(every, axis=0).max() / 2
    bend = _deformation(rng)
    pose = rotation(rng) if rng.random() < 0.12 else tilt(rng, 0.12)
    shaped = [Surface(bend((part.surface.vertices - centre) / reach) @ pose.T, part.surface.faces) for part in a.parts]
    every = np.concatenate([surface.vertices for surface in shaped])
    centre = (every.min(0) + every.max(0)) / 2
    radius = np.linalg.norm(every - centre, axis=1).max()
    first = np.cumsum([0, *(len(surface.vertices) for surface in shaped)])
    local_axis = [np.abs(face_normals(Surface(part.local, part.surface.faces))).argmax(1) for part in a.parts]
    return SolidObject(
        vertices=((every - centre) / radius).astype(np.float32),
        faces=np.concatenate([s.faces + n for s, n in zip(shaped, first, strict=False)]).astype(np.int32),
        normals=np.concatenate([corner_normals(s, p.crease) for s, p in zip(shaped, a.parts, strict=True)]).astype(np.float32),
        local=np.concatenate([part.local[part.surface.faces] for part in a.parts]).astype(np.float32),
        slot=np.concatenate([np.full(len(part.surface.faces), part.slot) for part in a.parts]),
        axis=np.concatenate(local_axis),
        slots=a.slots,
    )


def _deformation(rng: Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Taper, twist and bow of the whole object, each in a share of the objects; points (N, 3) to points (N, 3)."""
    taper, twist, bow = rng.normal(0, [0.25, 0.5, 0.2]) * (rng.random(3) < 0.25)

    def deform(p: np.ndarray) -> np.ndarray:
        size = np.exp(-taper * p[:, 2:])
        angle = twist * p[:, 2]
        x, y = (p[:, :2] * size).T
        turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, p[:, 2]], -1)
        turned[:, 0] += bow * p[:, 2] ** 2
        return turned

    return deform
