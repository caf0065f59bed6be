"""What every tracer of rays against a fixed mesh does, whatever finds its hits."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from ia_bench.scenes.scene import Mesh


class RayCaster(ABC):
    """A ray tracer.

    Attributes:
        mesh: The triangles that it traces.
        rays: How many rays it has traced so far.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh, self.rays = mesh, 0

    def intersect(
        self, origins: Tensor, directions: Tensor, asked: Tensor | None = None, *, coherent: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Nearest hits of rays, (N, 3) origins and directions.

        Returns the triangle (N,) int64, -1 for a miss; the barycentrics (N, 2) of corners 1 and 2; the distance (N,), Inf
        for a miss. Or (N, K) of each for (N, K, 3) directions, K from every origin, of which only those are traced that are
        ``asked`` (N, K) bool for; the others count as misses.

        ``coherent`` says that rays that follow each other take nearly the same way, which some tracers find sooner.
        """
        shape, device = directions.shape[:-1], origins.device
        face = torch.full(shape, -1, dtype=torch.int32, device=device)
        barycentric, distance = torch.zeros(*shape, 2, device=device), torch.full(shape, torch.inf, device=device)
        self._ask(True, origins, directions, asked, coherent, face.reshape(-1), barycentric.reshape(-1, 2), distance.reshape(-1))
        return face.long(), barycentric, distance

    def occluded(self, origins: Tensor, directions: Tensor, asked: Tensor | None = None) -> Tensor:
        """Whether rays of infinite length hit anything: (N,) bool for (N, 3) origins and directions.

        Or (N, K) for (N, K, 3) directions, as :meth:`intersect` has them; those that are not asked for count as free.
        """
        blocked = torch.zeros(directions.shape[:-1], dtype=torch.uint8, device=origins.device)
        self._ask(False, origins, directions, asked, False, blocked.reshape(-1))
        return blocked.bool()

    def _ask(
        self, nearest: bool, origins: Tensor, directions: Tensor, asked: Tensor | None, coherent: bool, *results: Tensor
    ) -> None:
        count = directions.numel() // 3
        if count:
            mask = None if asked is None else asked.contiguous().view(torch.uint8).reshape(-1)
            self._trace(nearest, origins.contiguous(), directions.contiguous().reshape(-1, 3), mask, coherent, *results)
        self.rays += count if asked is None else int(asked.sum())

    @abstractmethod
    def _trace(
        self, nearest: bool, origins: Tensor, directions: Tensor, asked: Tensor | None, coherent: bool, *results: Tensor
    ) -> None:
        """Fill ``results`` for (M, 3) directions, as many after another of each origin.

        They are triangle, barycentrics and distance of the ``nearest`` hit, else whether there is any. ``asked`` (M,) uint8.
        """
