"""Renders training images: views of one procedural object, each under a light, a camera and materials of its own.

Image = direct diffuse + direct specular + one bounce of diffuse light from diffuse surfaces. Left out: what is reflected
specularly after or before a bounce, and all further bounces.

Why it stands beside :mod:`ia_bench.render`: on one core it makes 15 images of 64 x 64 a second, that one 6.4 (2.3 times fewer), for
there every object must be unwrapped (46 ms an image) and its procedural materials baked into textures (50 ms) before any ray.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench.material.brdf import GOLDEN, PLASTIC, dot, normalize
from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.rays import EmbreeRays
from ia_bench.scenes.scene import Camera, Mesh
from ia_bench_training.cameras import draw_camera
from ia_bench_training.lights import Light, draw_light
from ia_bench_training.objects import SolidObject
from ia_bench_training.shading import OFFSET, DirectLight, LightTables, cosine_directions
from ia_bench_training.smooth import smooth_shading
from ia_bench_training.textures import TexturedMaterial, draw_materials

SIDE = 2  # primary points per pixel and axis
POINTS = SIDE * SIDE
LIGHT_SAMPLES, BRDF_SAMPLES, COSINE_RAYS = 9, 3, 4  # per point: 64 directions a pixel
VIEWS = 8  # images of one object
MIN_COVERAGE, MAX_COVERAGE = 0.05, 0.98
MEAN_RADIANCE = 0.3
_PLASTIC_2 = (PLASTIC, PLASTIC * PLASTIC)  # generators of Roberts' R2 sequence


@dataclass(frozen=True)
class ViewDraw:
    """Everything random about one image of S x S pixels.

    Attributes:
        camera: Where it is seen from.
        light: What lights it.
        materials: One for each slot of the object.
        exposure: The mean radiance of the object in the photograph.
        shift: (S, S, 4, 2) float32, by which each pixel's four lattices are moved.
    """

    camera: Camera
    light: Light
    materials: list[TexturedMaterial]
    exposure: float
    shift: np.ndarray


def draw_view(rng: Generator, solid: SolidObject, size: int) -> ViewDraw:
    """Draw camera, light, materials, exposure and sampling lattices of one image of ``size`` pixels a side."""
    return ViewDraw(
        draw_camera(rng, solid.vertices, size),
        draw_light(rng),
        draw_materials(rng, solid.slots),
        float(np.exp(rng.normal(np.log(MEAN_RADIANCE), 0.25))),
        rng.random((size, size, 4, 2), dtype=np.float32),
    )


@dataclass(frozen=True)
class _Hits:
    position: Tensor
    normal: Tensor
    geometric: Tensor
    local: Tensor
    axis: Tensor
    slot: Tensor


class ObjectRenderer:
    """An object that rays can be traced against. It renders any number of views of it."""

    def __init__(self, solid: SolidObject, direct: DirectLight) -> None:
        self._direct = direct
        self.solid = solid
        empty = np.zeros((0, 3), np.float32)
        self._rays = EmbreeRays(Mesh(solid.vertices, solid.faces, empty, empty))
        corners = torch.from_numpy(solid.vertices)[torch.from_numpy(solid.faces).long()]
        self._corners = torch.cat([corners, torch.from_numpy(solid.normals), torch.from_numpy(solid.local)], -1)
        self._geometric = normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        self._slot, self._axis = torch.from_numpy(solid.slot), torch.from_numpy(solid.axis)

    def coverage(self, face: Tensor) -> Tensor:
        """Fraction of each view that the object covers, from (V, S, S, POINTS) faces: (V,)."""
        return (face >= 0).float().flatten(1).mean(1)

    def trace(self, views: Sequence[ViewDraw]) -> tuple[Tensor, Tensor]:
        """Primary rays of all views: face (V, S, S, POINTS), -1 for a miss, and barycentrics (V, S, S, POINTS, 2)."""
        size = views[0].camera.width
        grids = [primary_rays(view.camera, SIDE) for view in views]
        origin, direction = (torch.from_numpy(np.concatenate([g[i] for g in grids])).reshape(-1, 3) for i in (0, 1))
        face, barycentric, _ = self._rays.intersect(origin, direction)
        shape = (len(views), size, size, POINTS)
        return face.reshape(shape), barycentric.reshape(*shape, 2)

    def render(self, views: Sequence[ViewDraw], face: Tensor, barycentric: Tensor) -> dict[str, Tensor]:
        """Images of views whose primary rays hit as :meth:`trace` says, by the names of ``shards.CHANNELS``, float32.

        Radiance is in the unit of the lights; :func:`expose` makes photographs of it.
        """
        count, size = face.shape[:2]
        view, row, column, point = torch.nonzero(face >= 0, as_tuple=True)
        centres = torch.from_numpy(np.stack([v.camera.to_world[:3, 3] for v in views])).float()
        hits = self._surface(face[view, row, column, point], barycentric[view, row, column, point], centres[view])
        toward = normalize(centres[view] - hits.position)
        hits = _bend(hits, toward)
        shift = torch.from_numpy(np.stack([v.shift for v in views]))[view, row, column]
        lights = [v.light for v in views]
        tables = LightTables.build(lights + lights[:1] * (VIEWS - len(lights)))  # one shape for the compiler

        cosine_rays = cosine_directions(hits.normal, lattice(shift[:, 0], point, COSINE_RAYS).float())
        reaches_sky, landed, owner, ray = self._bounce(hits, cosine_rays)
        both = [(view, view[owner]), *((getattr(hits, name), getattr(landed, name)) for name in ("slot", "local", "axis"))]
        albedo, roughness = self._materials(views, *map(torch.cat, both))
        own = slice(0, len(view))
        u_light, u_brdf = lattice(shift[:, 1], point, LIGHT_SAMPLES), lattice(shift[:, 2], point, BRDF_SAMPLES).float()
        place = (view, hits.position, hits.normal, toward, hits.geometric, roughness[own])
        irradiance, specular = self._direct(self._rays, tables, *place, cosine_rays, reaches_sky, u_light, u_brdf)
        number = (point[owner] * COSINE_RAYS + ray)[:, None].double()
        u = torch.remainder(shift[owner, 3] + number * torch.tensor(_PLASTIC_2, dtype=torch.float64), 1.0)
        indirect = self._indirect(tables, view[owner], landed, albedo[len(view) :], u, owner, len(view))
        diffuse = albedo[own] * (irradiance + indirect)

        to_camera = torch.from_numpy(np.stack([v.camera.to_world[:3, :3] for v in views])).float()
        normal = torch.einsum("nw,nwc->nc", hits.normal, to_camera[view])
        columns = [diffuse, torch.ones(len(view), 1), albedo[own], specular, normal, reaches_sky.float().mean(1, keepdim=True)]
        flat = torch.zeros(count * size * size, 14)
        flat.index_add_(0, (view * size + row) * size + column, torch.cat(columns, -1) / POINTS)
        pixels = flat.reshape(count, size, size, 14)
        diffuse, coverage, base, specular, normal, sky = pixels.split([3, 1, 3, 3, 3, 1], -1)
        diffuse, sky = smooth_shading(diffuse, base, normal, sky, coverage)
        image = torch.cat([diffuse + specular, coverage], -1)
        return {"image": image, "albedo": base, "specular": specular, "normal": normal, "visibility": sky}

    def _surface(self, face: Tensor, barycentric: Tensor, seen_from: Tensor) -> _Hits:
        """Interpolate hits, turned to the side that they are seen from."""
        weight = torch.cat([1 - barycentric.sum(-1, keepdim=True), barycentric], -1)
        position, normal, local = torch.bmm(weight[:, None], self._corners[face])[:, 0].split(3, -1)
        geometric = self._geometric[face]
        side = torch.where(dot(geometric, seen_from - position) < 0, -1.0, 1.0)
        normal = normalize(normal) * torch.where(dot(normal, geometric) < 0, -side, side)
        return _Hits(position, normal, geometric * side, local, self._axis[face], self._slot[face])

    def _bounce(self, hits: _Hits, direction: Tensor) -> tuple[Tensor, _Hits, Tensor, Tensor]:
        """Trace rays (N, A, 3): which reach the sky (N, A), where the others land, and which point and ray these belong to."""
        above = dot(direction, hits.geometric[:, None])[..., 0] > 0
        start = (hits.position + OFFSET * hits.geometric)[:, None].expand_as(direction)
        face, barycentric, _ = self._rays.intersect(start.reshape(-1, 3), direction.reshape(-1, 3))
        face = face.reshape(above.shape)
        owner, ray = torch.nonzero(above & (face >= 0), as_tuple=True)
        landed = self._surface(face[owner, ray], barycentric.reshape(*above.shape, 2)[owner, ray], hits.position[owner])
        return above & (face < 0), landed, owner, ray

    def _indirect(
        self, tables: LightTables, view: Tensor, landed: _Hits, albedo: Tensor, u: Tensor, owner: Tensor, points: int
    ) -> Tensor:
        """Mean diffuse radiance over each point's cosine rays, zero for those that reach the sky: (points, 3).

        Direct light there is estimated from one direction by the light and one by the cosine, both from ``u`` (R, 2).
        """
        away = cosine_directions(landed.normal, torch.remainder(u + 0.5, 1.0)[:, None].float())
        place = (view, landed.position, landed.normal, landed.normal, landed.geometric, torch.ones(len(owner), 1))
        irradiance, _ = self._direct(self._rays, tables, *place, away, None, u[:, None], torch.zeros(len(owner), 0, 2))
        total = torch.zeros(points, 3)
        return total.index_add_(0, owner, albedo * irradiance / COSINE_RAYS)

    def _materials(
        self, views: Sequence[ViewDraw], view: Tensor, slot: Tensor, local: Tensor, axis: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Albedo (N, 3) and roughness (N, 1) of points, every view with materials of its own."""
        albedo, roughness = torch.empty(len(view), 3), torch.empty(len(view), 1)
        key = view * self.solid.slots + slot
        order = torch.argsort(key, stable=True)
        counts = torch.bincount(key, minlength=len(views) * self.solid.slots).tolist()
        for number, index in enumerate(order.split(counts)):
            if len(index):
                material = views[number // self.solid.slots].materials[number % self.solid.slots]
                albedo[index], roughness[index] = material(local[index], axis[index])
        return albedo, roughness


def expose(images: dict[str, Tensor], views: Sequence[ViewDraw]) -> dict[str, Tensor]:
    """Scale image and specular so that the mean radiance over the object is the view's exposure."""
    image = images["image"]
    mean = image[..., :3].mean(-1).sum((1, 2)) / image[..., 3].sum((1, 2))
    scale = (torch.tensor([view.exposure for view in views]) / mean)[:, None, None, None]
    exposed = torch.cat([scale * image[..., :3], image[..., 3:]], -1)
    return {**images, "image": exposed, "specular": scale * images["specular"]}


def _bend(hits: _Hits, toward: Tensor) -> _Hits:
    """Shading normals that face away from the camera at a coarse silhouette are bent to grazing."""
    cosine = dot(hits.normal, toward)
    bent = torch.where(cosine < 1e-3, normalize(hits.normal + (2e-3 - cosine) * toward), hits.normal)
    return replace(hits, normal=bent)


def lattice(shift: Tensor, point: Tensor, count: int) -> Tensor:
    """``count`` samples in [0, 1)^2 for each point, (N, count, 2) float64: the pixel's rank-1 lattice moved by ``shift`` (N, 2).

    ``point`` (N,) in [0, POINTS) says which of the pixel's points it is: they share the lattice between them.
    """
    index = (torch.arange(count) * POINTS + torch.arange(POINTS)[:, None]).double()
    generators = torch.stack([index / (count * POINTS), index * GOLDEN], -1)
    return (shift[:, None] + generators[point]).frac_()
