"""Rays against a fixed mesh, behind one small interface: Embree on the CPU, Warp on CUDA."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ia_bench.scenes.scene import Mesh


class RayCaster(Protocol):
    """What the renderer asks of a ray tracer of a ``mesh``. ``rays`` counts every ray traced so far."""

    mesh: Mesh
    rays: int

    def intersect(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Nearest hits of (N, 3) rays.

        Returns the triangle (N,) int64, -1 for a miss; the barycentrics (N, 2) of corners 1 and 2; the distance (N,), Inf
        for a miss.
        """
        ...

    def occluded(self, origins: Tensor, directions: Tensor) -> Tensor:
        """Whether (N, 3) rays of infinite length hit anything: (N,) bool."""
        ...


class EmbreeRays:
    """Embree through ``embreex``; batches are split over the threads that torch is allowed to use."""

    def __init__(self, mesh: Mesh) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
        self.mesh = mesh
        self._workers = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(self._workers)
        self.rays = 0

    def intersect(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See :meth:`RayCaster.intersect`."""
        hits = self._scene.run(origins.numpy(), directions.numpy(), query="INTERSECT", output=True)
        self.rays += len(origins)
        face = torch.from_numpy(hits["primID"]).long()
        distance = torch.from_numpy(hits["tfar"]).masked_fill(face < 0, torch.inf)
        return face, torch.from_numpy(np.stack([hits["u"], hits["v"]], -1)), distance

    def occluded(self, origins: Tensor, directions: Tensor) -> Tensor:
        """See :meth:`RayCaster.occluded`."""
        self.rays += len(origins)
        parts = zip(
            np.array_split(origins.numpy(), self._workers), np.array_split(directions.numpy(), self._workers), strict=True
        )
        blocked = list(self._pool.map(lambda part: self._scene.run(*part, query="OCCLUDED") >= 0, parts))
        return torch.from_numpy(np.concatenate(blocked))


def make_rays(mesh: Mesh, device: torch.device) -> RayCaster:
    """The exact tracer of the device: Embree on the CPU, Warp on CUDA."""
    if device.type == "cpu":
        return EmbreeRays(mesh)
    from ia_bench.render.warp_rays import WarpRays

    return WarpRays(mesh, device)
