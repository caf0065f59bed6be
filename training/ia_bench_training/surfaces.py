"""Building blocks of procedural objects: closed triangle meshes of about unit size, as (vertices, faces) arrays.

Nearly everything is a stack of closed loops joined by quads: revolutions, extrusions, superquadrics, swept tubes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ia_bench_training.noise import FIRST, fractal


@dataclass(frozen=True)
class Surface:
    """Triangles: ``vertices`` (V, 3) float64 and ``faces`` (F, 3) int64, which are counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray


def skin(loops: np.ndarray, *, around: bool = False) -> Surface:
    """Join (R, M, 3) closed loops of M points by quads; ``around`` joins the last loop with the first as well.

    Loops that shrink to a point close an end; their degenerate triangles are dropped by :func:`weld`.
    """
    rows, columns, _ = loops.shape
    row = np.arange(rows if around else rows - 1)[:, None]
    column = np.arange(columns)[None]
    after, beside = (row + 1) % rows, (column + 1) % columns
    a, b, c, d = (r * columns + k for r, k in ((row, column), (row, beside), (after, beside), (after, column)))
    quads = np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)
    return weld(Surface(loops.reshape(-1, 3), quads))


def weld(surface: Surface) -> Surface:
    """Merge vertices that are the same when rounded to 1e-5, drop triangles two corners of which are one."""
    keys = np.round(surface.vertices * 1e5).astype(np.int64) @ np.array([1, 2_097_152, 4_398_046_511_104])
    _, first, same = np.unique(keys, return_index=True, return_inverse=True)
    faces = same.reshape(-1)[surface.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Surface(surface.vertices[first], faces[whole])


def _signed_power(x: np.ndarray, exponent: float) -> np.ndarray:
    return np.sign(x) * np.abs(x) ** exponent


def superquadric(upright: float, around: float, detail: int = 32) -> Surface:
    """Superquadric of half sizes 1 (Barr 1981); exponents 1 give a sphere, near 0 a box or cylinder, 2 an octahedron."""
    v = np.linspace(-math.pi / 2, math.pi / 2, detail // 2 + 1)[:, None]
    u = np.arange(detail) * (2 * math.pi / detail)
    ring = _signed_power(np.cos(v), upright)
    x, y = ring * _signed_power(np.cos(u), around), ring * _signed_power(np.sin(u), around)
    return skin(np.stack([x, y, np.broadcast_to(_signed_power(np.sin(v), upright), x.shape)], -1))


def rounded_box(half: np.ndarray, bevel: float, steps: int = 4) -> Surface:
    """A box of the given half sizes (3,) whose edges and corners are rounded with radius ``bevel``."""
    bevel = min(bevel, 0.98 * float(half.min()))
    inner = half - bevel
    vertices, faces, count = [], [], 0
    for axis in range(3):
        for sign in (-1.0, 1.0):
            others = [(axis + 1) % 3, (axis + 2) % 3]
            lines = []
            for other in others:
                edge = inner[other] + bevel * np.tan(np.linspace(0, math.pi / 4, steps + 1))  # even arcs after projection
                line = np.concatenate([-edge[::-1], edge])
                lines.append(line)
            a, b = np.meshgrid(*lines, indexing="ij")
            points = np.empty((*a.shape, 3))
            points[..., axis] = sign * half[axis]
            points[..., others[0]], points[..., others[1]] = a, b
            core = np.clip(points, -inner, inner)
            outward = points - core
            points = core + bevel * outward / np.linalg.norm(outward, axis=-1, keepdims=True)
            rows, columns = a.shape
            r, c = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
            first = count + r * columns + c
            corners = [first, first + columns, first + columns + 1, first + 1]
            if sign < 0:
                corners = corners[::-1]
            faces.append(np.stack([corners[i] for i in (0, 1, 2, 0, 2, 3)], -1).reshape(-1, 3))
            vertices.append(points.reshape(-1, 3))
            count += rows * columns
    return weld(Surface(np.concatenate(vertices), np.concatenate(faces)))


def revolve(profile: np.ndarray, segments: int = 40, *, lobes: int = 0, depth: float = 0.0, closed: bool = False) -> Surface:
    """Turn an (M, 2) profile of (radius, height), from bottom to top outside, around z.

    ``lobes`` waves of relative ``depth`` run around it (flutes, pumpkins); ``closed`` profiles are rings.
    """
    angle = np.arange(segments) * (2 * math.pi / segments)
    wave = 1 + depth * np.cos(lobes * angle)
    radius = profile[:, :1] * wave
    height = np.broadcast_to(profile[:, 1:], radius.shape)
    return skin(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1), around=closed)


def extrude(outline: np.ndarray, half: float, bevel: float, *, twist: float = 0.0, taper: float = 0.0, steps: int = 8) -> Surface:
    """Extrude a star-shaped (M, 2) outline along z over [-half, half], with bevelled rims, twist (rad) and taper."""
    height = np.concatenate([[-half, -half], np.linspace(-half + bevel, half - bevel, steps), [half, half]])
    size = np.concatenate([[0, 1 - bevel], np.ones(steps), [1 - bevel, 0]]) * (1 - taper * (height / half + 1) / 2)
    angle = twist * height / (2 * half)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = outline[:, 0], outline[:, 1]
    flat = np.stack([cos * x - sin * y, sin * x + cos * y], -1) * size[:, None, None]
    return skin(np.concatenate([flat, np.broadcast_to(height[:, None, None], (*flat.shape[:2], 1))], -1))


def sweep(path: np.ndarray, section: np.ndarray, scale: np.ndarray | float = 1.0, *, closed: bool = False) -> Surface:
    """Sweep a closed (K, 2) section along an (M, 3) path by parallel transport; ends are capped unless it is ``closed``."""
    tangent = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    first = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    normals = [first / np.linalg.norm(first)]
    for along in tangent[1:]:
        moved = normals[-1] - (normals[-1] @ along) * along
        normals.append(moved / np.linalg.norm(moved))
    normal = np.stack(normals)
    side = np.cross(tangent, normal)
    if closed:  # spread the twist that one round leaves
        end = normal[-1] - (normal[-1] @ tangent[0]) * tangent[0]
        gap = math.atan2(end @ side[0], end @ normal[0]) * np.linspace(0, 1, len(path))[:, None]
        normal, side = np.cos(gap) * normal - np.sin(gap) * side, np.sin(gap) * normal + np.cos(gap) * side
    size = np.broadcast_to(scale, len(path))[:, None, None]
    loops = path[:, None] + size * (section[:, :1] * normal[:, None] + section[:, 1:] * side[:, None])
    if not closed:
        loops = np.concatenate([np.broadcast_to(path[:1], loops[:1].shape), loops, np.broadcast_to(path[-1:], loops[:1].shape)])
        loops[0], loops[-1] = path[0], path[-1]
    return skin(loops, around=closed)


def displace(surface: Surface, frequency: float, amount: float, octaves: int, shift: np.ndarray) -> Surface:
    """Move vertices along their normals by ``amount`` times fractal noise, whose standard deviation is about 1.25."""
    at = torch.from_numpy(surface.vertices * frequency + shift).float()
    height = fractal(at, octaves, channels=FIRST).double().numpy()
    return Surface(surface.vertices + amount * height * vertex_normals(surface), surface.faces)


def face_normals(surface: Surface) -> np.ndarray:
    """Normals (F, 3) whose length is twice the triangle's area."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(surface: Surface) -> np.ndarray:
    """Unit normals (V, 3), averages over the triangles weighted by area."""
    flat = face_normals(surface)
    total = np.stack([np.bincount(surface.faces.ravel(), np.repeat(flat[:, i], 3), len(surface.vertices)) for i in range(3)], -1)
    return total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)


def corner_normals(surface: Surface, crease: float) -> np.ndarray:
    """Shading normals of every triangle's corners, (F, 3, 3).

    A corner's normal is the mean, weighted by area, of those triangles around the vertex that lie within ``crease`` radians
    of this one. So sharp edges stay sharp.
    """
    flat = face_normals(surface)
    unit = flat / np.linalg.norm(flat, axis=1, keepdims=True).clip(1e-20)
    corner = surface.faces.ravel()
    order = np.argsort(corner, kind="stable")
    valence = np.bincount(corner, minlength=len(surface.vertices))
    start = np.cumsum(valence) - valence
    own = np.repeat(order, valence[corner[order]])  # every corner once per corner that shares its vertex
    pairs = valence[corner[order]]
    within = np.arange(len(own)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    other = order[start[corner[own]] + within]
    near = (unit[own // 3] * unit[other // 3]).sum(1) >= math.cos(crease) - 1e-6
    own, other = own[near], other[near] // 3
    total = np.stack([np.bincount(own, flat[other, i], len(corner)) for i in range(3)], -1)
    return (total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-20)).reshape(-1, 3, 3)
