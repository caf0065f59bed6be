"""The training pixels that show nothing but the object, and the surface points behind them."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Problem
from ia_bench.methods.photographs import Photographs, one_sided
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, SurfacePoints

COVERED = 0.999  # of a pixel that shows the object alone


class TrainingPixels:
    """Pixels (P,) of all training views that lie wholly inside the object, as methods that shade points are trained on.

    Attributes:
        gbuffer: What the training cameras see.
        entries: (P,) int64, which pixels of the G-buffer these are.
        radiance: (P, 3) of the photographs, linear.
        view: (P,) int64, the photograph that each belongs to.
    """

    def __init__(self, problem: Problem, side: int = 1) -> None:
        """``side`` x ``side`` points a pixel; 1 is the ray through its centre, which the original methods take.

        Raises InputError where no pixel lies inside the object.
        """
        self._surface: SurfaceInterpolator = problem.stage.surface
        self.gbuffer: GBuffer = problem.stage.gbuffer([view.camera for view in problem.scene.train], side)
        photographs = Photographs.of(problem.scene, self.gbuffer)
        self.entries = torch.nonzero(self.gbuffer.filled & (photographs.mask[:, 0] > COVERED))[:, 0]
        if len(self.entries) == 0:
            raise InputError(f"{problem.scene.source}: expected training pixels that show nothing but the object, found none")
        self.radiance, self._known = photographs.radiance[self.entries], photographs.known[self.entries]
        self.view = self.gbuffer.view(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """``count`` of the P pixels at random, with repetition."""
        return torch.randint(len(self), (count,), generator=generator, device=self.entries.device)

    def target(self, pixels: Tensor, rendered: Tensor) -> Tensor:
        """What the render (N, 3) of ``pixels`` (N,) in [0, P) is compared with: one-sidedly where photographs saturate."""
        return one_sided(self.radiance[pixels], rendered, self._known[pixels])

    def points(self, pixels: Tensor) -> SurfacePoints:
        """The surface points of ``pixels`` (N,) in [0, P), ``side`` ^ 2 of each, one pixel after the other."""
        entries = self.entries[pixels]
        face = self.gbuffer.face[entries]
        origin = self.gbuffer.seen_from(entries).repeat_interleave(face.shape[1], 0)
        return self._surface(face.reshape(-1), self.gbuffer.barycentric[entries].reshape(-1, 2), origin)
