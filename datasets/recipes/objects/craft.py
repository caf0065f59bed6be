"""What the bowl of fruit and the cloth bear share: paint kept within bounds, stitches, stuffed shapes, patches, ribbons."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .forms import cells, grid_surface, mesh_object, solid, store_chart, threads
from .paint import Paint, Socket, Value

DARKEST, BRIGHTEST = 0.03, 0.85
"""Bounds of the albedo's channels, linear."""


# ---------------------------------------------------------------- paint
def clamp(paint: Paint, value: Value, low: float, high: float) -> Socket:
    """`value` within [low, high]."""
    return paint.formula("minimum(high, maximum(low, v))", v=value, low=low, high=high)


def finish(paint: Paint, colour: Value, roughness: Value, low: float, high: float) -> bpy.types.Material:
    """Finish a paint with its roughness kept within [low, high], its colour within [DARKEST, BRIGHTEST]."""
    colour = paint.vector("MINIMUM", paint.vector("MAXIMUM", colour, (DARKEST,) * 3), (BRIGHTEST,) * 3)
    return paint.finish(colour, clamp(paint, roughness, low, high))


# ---------------------------------------------------------------- sewn things
def stitches(name: str, starts: np.ndarray, ends: np.ndarray, up: np.ndarray, width: float, paint: bpy.types.Material) -> None:
    """Short threads from `starts` to `ends` (n, 3) that stand out along `up` (n, 3), `width` wide, both ends under the cloth."""
    length = np.linalg.norm(ends - starts, axis=1, keepdims=True)
    along = (ends - starts) / length
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    side, low = np.cross(along, up), -0.5 * width * up
    spines = [starts + low, starts + 0.2 * length * along, ends - 0.2 * length * along, ends + low]
    sections = [0.5 * width * side, 0.45 * width * up, -0.5 * width * side]
    solid(name, *threads(np.stack(spines, axis=1), np.stack(sections, axis=1)), paint, sharp_deg=75.0)


def strip(name: str, points: np.ndarray, paint: bpy.types.Material, thickness: float, wide: np.ndarray | None = None) -> None:
    """Closed band of cloth or leaf round a sheet of points (along, across, 3), facing (d/d across) x (d/d along).

    Its chart is (share of the length, `wide`, 0), `wide` (across,) from -1 to 1 unless given.
    """
    rows, columns, _ = points.shape
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal *= 0.5 * thickness / np.linalg.norm(normal, axis=-1, keepdims=True)
    rings = np.concatenate([points + normal, (points - normal)[:, ::-1]], axis=1)
    across = np.linspace(-1.0, 1.0, columns) if wide is None else wide
    v, u = np.meshgrid(np.concatenate([across, across[::-1], across[:1]]), np.linspace(0.0, 1.0, rows))
    grid_surface(name, rings, paint, np.stack([u, v, 0.0 * u], axis=-1), sharp_deg=60.0)


def pad(
    name: str,
    frame: np.ndarray,
    centre: np.ndarray,
    radii: tuple[float, float],
    profile: list[tuple[float, float]],
    paint: bpy.types.Material,
    columns: int = 20,
    outline: np.ndarray | float = 1.0,
) -> None:
    """Button, ear or sole: an oval of `radii` along the first two columns of `frame`, its face along the third.

    `profile` is (share of the radius, height) from the back to the front; `outline` scales the radius round the oval.
    The chart is (first coordinate, second coordinate, share of the profile).
    """
    angle = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    share, height = (np.array(column)[:, None] for column in zip(*profile, strict=True))
    flat = np.stack([radii[0] * share * outline * np.cos(angle), radii[1] * share * outline * np.sin(angle)], axis=-1)
    rings = flat @ frame[:, :2].T + height[..., None] * frame[:, 2] + centre
    chart = np.concatenate([flat, np.repeat(np.linspace(0.0, 1.0, len(profile))[:, None, None], columns, axis=1)], axis=-1)
    grid_surface(name, rings, paint, np.concatenate([chart, chart[:, :1]], axis=1), sharp_deg=60.0)


@dataclass(frozen=True)
class Skin:
    """Closed surface through `rings` (rows, columns, 3), addressed by u round it, from 0 to 1, and v along it.

    Rings run as `grid_surface` wants them: (d/du) x (d/dv) points out.
    """

    rings: np.ndarray

    def at(self, u: np.ndarray, v: np.ndarray, lift: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Points `lift` above the surface and its normals, both (..., 3)."""
        u, v, lift = np.broadcast_arrays(u, v, lift)
        rows, columns, _ = self.rings.shape
        round_ = np.roll(self.rings, -1, axis=1) - np.roll(self.rings, 1, axis=1)
        normals = np.cross(round_, np.gradient(self.rings, axis=0))
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        a, b = (u % 1.0) * columns, np.clip(v, 0.0, 1.0) * (rows - 1)
        i, j = np.minimum(b.astype(int), rows - 2), a.astype(int) % columns
        f, g, k = (a % 1.0)[..., None], (b - i)[..., None], (j + 1) % columns
        point, normal = (
            (1 - g) * ((1 - f) * field[i, j] + f * field[i, k]) + g * ((1 - f) * field[i + 1, j] + f * field[i + 1, k])
            for field in (self.rings, normals)
        )
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        return point + lift[..., None] * normal, normal

    def build(self, name: str, paint: bpy.types.Material, scale: tuple[float, float], relief: np.ndarray | float = 0.0) -> None:
        """Make the surface, raised by `relief` (rows, columns); its chart is (u, v, 0) times `scale`."""
        rows, columns, _ = self.rings.shape
        v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns + 1), indexing="ij")
        points, _ = self.at(u[:, :-1], v[:, :-1], relief)
        grid_surface(name, points, paint, np.stack([scale[0] * u, scale[1] * v, 0.0 * u], axis=-1))

    def facing(self, direction: tuple[float, float, float], v: float) -> float:
        """The u at `v` where the normal is nearest to `direction`."""
        u = np.linspace(0.0, 1.0, 100, endpoint=False)
        _, normal = self.at(u, np.array(v))
        return float(u[np.argmax(normal @ np.array(direction))])

    def steps(self, u: float, v: float) -> tuple[float, float]:
        """Lengths of d/du and d/dv at a place."""
        e = 0.01
        points, _ = self.at(np.array((u - e, u + e, u, u)), np.array((v, v, v - e, v + e)))
        return float(np.linalg.norm(points[1] - points[0])) / (2 * e), float(np.linalg.norm(points[3] - points[2])) / (2 * e)

    def patch(
        self,
        name: str,
        place: tuple[float, float],
        half: tuple[float, float],
        turn: float,
        cloth: bpy.types.Material,
        thread: bpy.types.Material,
        ground: float = 0.0,
    ) -> None:
        """Sew a piece of cloth on at `place` (u, v): `half` its sizes, turned by `turn`, over a relief `ground` high.

        Its chart is (x, y, 0), lengths from its middle. Its rim ends under the surface.
        """
        rng = np.random.default_rng(sum(map(ord, name)))
        du, dv = self.steps(*place)
        bend = rng.uniform(-0.06, 0.06, 4)

        def laid(s: np.ndarray, t: np.ndarray, lift: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
            x = half[0] * (s * (1.0 - 0.10 * t**4) + bend[0] * t**2 + bend[1] * np.sin(3.0 * t))
            y = half[1] * (t * (1.0 - 0.10 * s**4) + bend[2] * s**2 + bend[3] * np.sin(3.0 * s))
            c, n = np.cos(turn), np.sin(turn)
            point, normal = self.at(place[0] + (c * x - n * y) / du, place[1] + (n * x + c * y) / dv, lift)
            return point, normal, x, y

        edge = np.array([-1.0, -0.97, -0.65, -0.33, 0.0, 0.33, 0.65, 0.97, 1.0])
        t, s = np.meshgrid(edge, edge, indexing="ij")
        over = np.maximum(np.abs(s), np.abs(t))
        lift = np.where(over >= 1.0, -0.008, np.where(over > 0.9, 0.009 + ground, 0.014 + ground))
        lift = lift + 0.002 * rng.normal(size=s.shape) * (over < 0.9)
        points, _, x, y = laid(s, t, lift)
        item = mesh_object(name, points.reshape(-1, 3), cells(np.arange(81).reshape(9, 9)).tolist(), cloth)
        store_chart(item, cells(np.stack([x, y, 0.0 * x], axis=-1)))

        count = round(4.0 * (half[0] + half[1]) / 0.052)
        way = 4.0 * (np.arange(count) + 0.5 + rng.uniform(-0.2, 0.2, count)) / count
        side, along = way.astype(int), 2.0 * (way % 1.0) - 1.0
        s = np.choose(side, (along, 1.0, -along, -1.0))
        t = np.choose(side, (-1.0, along, 1.0, -along))
        slip = rng.uniform(-0.08, 0.08, count)
        reach = [1.0 + 0.020 / min(half), 1.0 - 0.024 / min(half)]
        (a, up, *_), (b, *_) = (
            laid(r * s + k * (side % 2 == 0), r * t + k * (side % 2), h)
            for r, k, h in zip(reach, (slip, -slip), (0.004 + ground, 0.016 + ground), strict=True)
        )
        stitches(f"{name} stitches", a, b, up, 0.013, thread)

    def seam(
        self, name: str, u: np.ndarray, v: np.ndarray, half: float, slant: float, thread: bpy.types.Material, lift: float = 0.003
    ) -> None:
        """Stitches across the line through (u, v), which runs along v: to `half` on either side, `slant` in units of it."""
        du, dv = zip(*(self.steps(a, b) for a, b in zip(u, v, strict=True)), strict=True)
        across, along = half / np.array(du), slant * half / np.array(dv)
        (a, up), (b, _) = self.at(u - across, v - along, lift), self.at(u + across, v + along, lift)
        stitches(name, a, b, up, 0.013, thread)
