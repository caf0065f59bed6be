"""A stage (:mod:`ia_bench.render.stage`) with what some cameras see of it."""

from __future__ import annotations

import torch

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render import stage
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.renderer import PixelRadiance, Renderer
from ia_bench.scenes.scene import Camera, Mesh

CPU = torch.device("cpu")


class Stage(stage.Stage):
    """A mesh seen by some cameras: ``seen``, with ``side`` x ``side`` points a pixel, and ``every`` entry of that G-buffer."""

    def __init__(self, mesh: Mesh, cameras: list[Camera], side: int = 1) -> None:
        super().__init__(mesh, CPU)
        self.seen = self.gbuffer(cameras, side)
        self.every = torch.arange(len(self.seen.pixel))

    def renderer(self, *, coat: str = "added", **settings: object) -> Renderer:
        """As everywhere, but for the coat, which is that of equation 2."""
        return super().renderer(coat=coat, **settings)

    def estimate(
        self, pixels: torch.Tensor, material: Material, light: SampledLight, samples: int, seed: int = 0, **settings: object
    ) -> PixelRadiance:
        """Entries ``pixels`` (P,) by the renderer of these settings."""
        generator = torch.Generator().manual_seed(seed)
        return self.renderer(**settings).render_pixels(self.seen, pixels, material, light, samples, generator)

    def points(self, pixels: torch.Tensor) -> SurfacePoints:
        """The surface at G-buffer entries (P,) that have one point each."""
        face, barycentric = self.seen.face[pixels, 0].long(), self.seen.barycentric[pixels, 0]
        return self.surface(face, barycentric, self.seen.seen_from(pixels))
