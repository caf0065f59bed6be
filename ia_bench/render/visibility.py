"""Whether a surface point sees the light in a direction: traced, or not asked at all."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.rays import RayCaster


class Visibility(Protocol):
    """What the estimator asks of shadows."""

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """Whether the mesh is in the way of N points in K directions each, (N, K, 3): (N, K) bool.

        False wherever it is not ``asked`` for, (N, K) bool.
        """
        ...


class NoShadows:
    """For convex objects: nothing ever blocks."""

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        return torch.zeros_like(asked)


class TracedShadows:
    """A ray per question, from a point lifted off its triangle by ``offset``. Exact."""

    def __init__(self, rays: RayCaster, offset: float) -> None:
        self._rays, self._offset = rays, offset

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """See :class:`Visibility`."""
        origin = points.position + self._offset * points.geometric
        return self._rays.occluded(origin, direction, asked)
