"""A reconstruction that shades points with a renderer of its own, and whose maps are textures baked from what it recovered."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from typing import Protocol

import torch
from torch import Tensor

from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material, fill_unobserved
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.indirect import Atlas
from ia_bench.render.reconstruction import Assets, Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera

POINTS_AT_ONCE = 2**14  # of a render
TEXELS_AT_ONCE = 2**16  # of a texture that is baked


class Shader(Protocol):
    """How a method shades surface points under one light."""

    def __call__(self, points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
        """Radiance (N, 3) toward the camera; ``albedo_scale`` (3,) multiplies the albedo."""
        ...


class ShadedReconstruction:
    """See :class:`ia_bench.render.reconstruction.Reconstruction`.

    Maps and assets are the method's textures. Renders are the method's own, at as many points a pixel as is asked for.
    """

    def __init__(
        self,
        stage: Stage,
        material: Material,
        *,
        renderer: str,
        environment: Environment | None,
        shader: Callable[[Environment | None, Quality], Shader | None],
        light_rows: int = 32,
        at_once: int = POINTS_AT_ONCE,
    ) -> None:
        """What was recovered.

        Args:
            stage: Of the mesh.
            material: Textures; see :func:`bake` for what is none.
            renderer: The name of what draws it.
            environment: The recovered light, None where the method has none that is infinitely far away.
            shader: Makes what shades points under a light, None standing for the recovered one; it answers None where the method
                cannot render under that light.
            light_rows: Of the lat-long map that an environment which is none is exported as.
            at_once: How many points are shaded together.
        """
        self.renderer, self.environment = renderer, environment
        light = None if environment is None else environment.latlong(light_rows)
        self._textures = TexturedReconstruction(stage, material, light)
        self._stage, self._shader, self._at_once = stage.apart, shader, at_once

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.maps`."""
        return self._textures.maps(cameras, names, points=points)

    @torch.no_grad()
    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.render`."""
        shade = self._shader(light, quality)
        if shade is None:
            return None
        images, coverage = [], []
        for gbuffer in self._stage.gbuffers(cameras, quality.points):
            mean = torch.zeros(len(gbuffer.pixel), 3, device=self._stage.device)
            hit = gbuffer.face >= 0
            entry, _ = torch.nonzero(hit, as_tuple=True)
            face, barycentric, origin = gbuffer.face[hit], gbuffer.barycentric[hit], gbuffer.seen_from(entry)
            for part in torch.arange(len(face), device=face.device).split(self._at_once):
                radiance = shade(self._stage.surface(face[part], barycentric[part], origin[part]), albedo_scale)
                mean.index_add_(0, entry[part], radiance / gbuffer.subsamples)
            images += list(gbuffer.images(mean).cpu().numpy())
            coverage += list(gbuffer.coverage().cpu().numpy())
        return Images(tuple(images), tuple(coverage))

    def assets(self) -> Assets:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.assets`."""
        return self._textures.assets()


@torch.no_grad()
def bake(stage: Stage, size: int, values: Callable[[Tensor], Tensor]) -> Tensor:
    """A texture (size, size, C) of ``values``, which gives (N, C) of positions (N, 3) on the mesh.

    Texels that lie on no triangle are filled from their neighbours.
    """
    atlas = Atlas.of(stage.mesh, size, stage.device)
    _, position = stage.surface.geometry(atlas.face, atlas.barycentric)
    found = torch.cat([values(part) for part in position.split(TEXELS_AT_ONCE)])
    texture = torch.zeros(size * size, found.shape[-1], device=stage.device)
    texture[atlas.place] = found
    there = torch.zeros(size * size, dtype=torch.bool, device=stage.device)
    there[atlas.place] = True
    return fill_unobserved(texture.reshape(size, size, -1), there.reshape(size, size))


def part_of(points: SurfacePoints, part: Tensor) -> SurfacePoints:
    """Some of the points, by their indices."""
    names = (field.name for field in fields(points))
    return SurfacePoints(**{name: getattr(points, name)[part] for name in names})
