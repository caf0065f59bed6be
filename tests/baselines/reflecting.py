"""Photographs of a known material, with light between parts of the object, by any method's sum over directions."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.textures import Material, fetch
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.indirect import Atlas
from ia_bench.render.reconstruction import Quality
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.shaded import ShadedReconstruction, Shader, part_of
from ia_bench_baselines.neilfpp.shading import sphere_directions
from tests.baselines.home_ground import smooth_light

Shade = Callable[[SurfacePoints, Tensor, Tensor, Tensor], Tensor]  # points, material (N, C), directions (D, 3), light (N, D, 3)
Draw = Callable[[torch.Generator], Tensor]
BOUNCES, DIRECTIONS, POINTS_AT_ONCE = 3, 256, 512
NORMAL = torch.tensor([0.0, 0.6, 0.8])
VIEW = torch.nn.functional.normalize(torch.tensor([0.5, 0.2, 0.7]), dim=0)
COLOUR = torch.tensor([0.2, 0.5, 0.8])


class Reflecting(ShadedReconstruction):
    """The truth of a home ground: what arrives is the light, or what a diffuse bounce on another part of the object sends."""

    def __init__(self, stage: Stage, material: Material, shade: Shade, draw: Draw) -> None:
        """``shade``: the method's forward model; ``draw``: gives its directions."""
        light = LatLongEnvironment(smooth_light())
        parts = [material.albedo, material.roughness] + ([] if material.metallic is None else [material.metallic])
        textures = torch.cat(parts, -1)
        sent = _radiosity(stage, material.albedo, light)

        def shader(novel: Environment | None, quality: Quality) -> Shader:
            generator = torch.Generator().manual_seed(quality.seed)

            def radiance(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
                seen = []
                for part in torch.arange(len(points.normal)).split(POINTS_AT_ONCE):
                    some, directions = part_of(points, part), draw(generator)
                    arriving = _arriving(stage, some.position, some.geometric, directions, light, sent)
                    seen.append(shade(some, fetch(textures, some.uv), directions, arriving))
                return torch.cat(seen)

            return radiance

        super().__init__(stage, material, renderer="home ground", environment=light, shader=shader)


def directions(rows: int = 256) -> tuple[Tensor, Tensor]:
    """Unit directions (T, 3) all over the sphere and the solid angle of each, float64."""
    return texel_centres(rows, 2 * rows).double().reshape(-1, 3), row_solid_angles(rows, 2 * rows).repeat_interleave(2 * rows)


def some_directions() -> Tensor:
    """200 unit directions, and that which mirrors VIEW at NORMAL."""
    drawn = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.normalize(torch.cat([drawn, (2 * (NORMAL @ VIEW) * NORMAL - VIEW)[None]]), dim=1)


def points_at(normal: Tensor, view: Tensor) -> SurfacePoints:
    """Points at the origin with these normals and views, (N, 3)."""
    zero = torch.zeros_like(normal)
    return SurfacePoints(zero, normal, view, zero[:, :2], normal, torch.ones(len(normal), 1, dtype=torch.bool))


def _arriving(stage: Stage, position: Tensor, normal: Tensor, directions: Tensor, light: Environment, sent: Tensor) -> Tensor:
    """(N, D, 3): ``light``, or the texture ``sent`` of what surfaces send where a ray hits one."""
    every = directions.expand(len(position), -1, -1).contiguous()
    free = light.radiance(directions).expand(len(position), -1, -1)
    return _met(stage, position + stage.surface.offset * normal, every, free, sent)


def _met(stage: Stage, start: Tensor, along: Tensor, free: Tensor, sent: Tensor) -> Tensor:
    """``free`` (..., 3) along rays that meet nothing, the texture ``sent`` where they meet the surface."""
    face, barycentric, _ = stage.rays.intersect(start, along)
    hit, seen = face >= 0, free.clone()
    seen[hit] = fetch(sent, stage.surface.uv(face[hit], barycentric[hit]))
    return seen


def _radiosity(stage: Stage, albedo: Tensor, light: Environment) -> Tensor:
    """A texture of the radiance that every texel sends, were the object matt: the series of its reflections, added up."""
    size = len(albedo)
    atlas = Atlas.of(stage.mesh, size, stage.device)
    normal, position = stage.surface.geometry(atlas.face, atlas.barycentric)
    sent, generator = torch.zeros(size, size, 3), torch.Generator().manual_seed(0)
    for _ in range(BOUNCES):
        directions, texels = sphere_directions(DIRECTIONS, generator), torch.zeros(size * size, 3)
        for part in torch.arange(len(normal)).split(POINTS_AT_ONCE):
            arriving = _arriving(stage, position[part], normal[part], directions, light, sent)
            cosine = (normal[part] @ directions.T).clamp_min(0)
            texels[atlas.place[part]] = (cosine[..., None] * arriving).sum(1) * (4 * math.pi / DIRECTIONS / math.pi)
        sent = texels.reshape(size, size, 3) * albedo
    return sent
