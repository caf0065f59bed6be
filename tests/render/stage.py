"""A mesh, its rays and a G-buffer, as the renderer wants them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, SurfacePoints, trace_gbuffer
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.render.renderer import NoShadows, Renderer, TracedShadows
from ia_bench.scenes.scene import Camera, Mesh

CPU = torch.device("cpu")


@dataclass
class Stage:
    """A mesh seen by some cameras."""

    mesh: Mesh
    surface: SurfaceInterpolator
    rays: RayCaster
    gbuffer: GBuffer

    @classmethod
    def of(cls, mesh: Mesh, cameras: list[Camera], side: int = 1) -> Stage:
        surface, rays = SurfaceInterpolator(mesh, CPU), make_rays(mesh, CPU)
        return cls(mesh, surface, rays, trace_gbuffer(cameras, rays, side, CPU))

    def renderer(self, *, shadows: bool = True) -> Renderer:
        return Renderer(self.surface, TracedShadows(self.rays, self.surface.offset) if shadows else NoShadows())

    def points(self, pixels: torch.Tensor) -> SurfacePoints:
        """The surface at G-buffer entries (P,) that have one point each."""
        face, barycentric = self.gbuffer.face[pixels, 0].long(), self.gbuffer.barycentric[pixels, 0]
        return self.surface(face, barycentric, self.gbuffer.seen_from(pixels))
