"""Rays against a fixed mesh, behind one small interface: Embree on the CPU, Warp on CUDA."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from ia_bench.scenes.scene import Mesh


class RayCaster(Protocol):
    """What the renderer asks of a ray tracer of a ``mesh``. ``rays`` counts every ray traced so far."""

    mesh: Mesh
    rays: int

    def intersect(
        self, origins: Tensor, directions: Tensor, asked: Tensor | None = None, *, coherent: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Nearest hits of rays, (N, 3) origins and directions.

        Returns the triangle (N,) int64, -1 for a miss; the barycentrics (N, 2) of corners 1 and 2; the distance (N,), Inf
        for a miss. Or (N, K) of each for (N, K, 3) directions, K from every origin, of which only those are traced that are
        ``asked`` (N, K) bool for; the others count as misses.

        ``coherent`` says that rays that follow each other take nearly the same way, which some tracers find sooner.
        """
        ...

    def occluded(self, origins: Tensor, directions: Tensor, asked: Tensor | None = None) -> Tensor:
        """Whether rays of infinite length hit anything: (N,) bool for (N, 3) origins and directions.

        Or (N, K) for (N, K, 3) directions, as :meth:`intersect` has them; those that are not asked for count as free.
        """
        ...


def make_rays(mesh: Mesh, device: torch.device) -> RayCaster:
    """The exact tracer of the device: Embree on the CPU, Warp on CUDA."""
    if device.type == "cpu":
        from ia_bench.render.embree import EmbreeRays

        return EmbreeRays(mesh)
    from ia_bench.render.warp_rays import WarpRays

    return WarpRays(mesh, device)
