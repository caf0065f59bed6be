"""Which share of a lobe reaches a surface point: rays in directions drawn from the lobe."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.spherical_gaussians.sampling import directions_of_lobes

RAYS_OF_REFLECTION = 4
WIDEST, NARROWEST = 0.1, 50.0  # sharpness of a reflected lobe whose visibility is asked for


class LobeVisibility:
    """Visibility of lobes, V(x) = the mean of v(x, w) over directions w in proportion to the lobe, estimated by a few rays.

    The original asks a network for v in 32 directions around every lobe. One ray a lobe has the same mean over the steps of a
    fit and the points of a picture. What is below the horizon of the point's triangle is not seen. No gradient passes.
    """

    def __init__(self, stage: Stage, generator: torch.Generator) -> None:
        """``generator``: draws the directions."""
        self._stage, self._generator = stage, generator

    @torch.no_grad()
    def of_light(self, points: SurfacePoints, axis: Tensor, sharpness: Tensor) -> Tensor:
        """Of M lobes that are the same for all N points, (M, 3) and (M,): (N, M) of 0 and 1, one ray each."""
        shape = len(points.position), *sharpness.shape
        return self._free(points, directions_of_lobes(axis.expand(*shape, 3), sharpness.expand(shape), self._generator))

    @torch.no_grad()
    def of_reflection(self, points: SurfacePoints, axis: Tensor, sharpness: Tensor) -> Tensor:
        """Of one reflected lobe of each point, (N, 3) and (N, 1): (N, 1), the mean of RAYS_OF_REFLECTION rays."""
        shape = len(axis), RAYS_OF_REFLECTION
        wide = sharpness.clamp(WIDEST, NARROWEST).expand(shape)
        return self._free(points, directions_of_lobes(axis[:, None].expand(*shape, 3), wide, self._generator)).mean(1, keepdim=True)

    def _free(self, points: SurfacePoints, directions: Tensor) -> Tensor:
        above = (directions @ points.geometric[:, :, None])[..., 0] > 0
        origin = points.position + self._stage.surface.offset * points.geometric
        return (above & ~self._stage.rays.occluded(origin, directions, above)).float()
