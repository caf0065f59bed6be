"""NVIDIA Warp as the ray tracer of CUDA devices (it also runs on the CPU, where the tests compare it with Embree)."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from ia_bench.common.warp_launch import launch
from ia_bench.scenes.scene import Mesh

FAR = 1e30


@wp.kernel(enable_backward=False)
def _nearest(
    first: int,
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    each: int,
    asked: wp.array(dtype=wp.uint8),
    faces: wp.array(dtype=wp.int32),
    barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=wp.float32),
):
    i = first + wp.tid()
    if asked[i] != wp.uint8(0):
        hit = wp.mesh_query_ray(mesh, origins[i // each], directions[i], FAR)
        if hit.result:
            faces[i] = hit.face
            barycentrics[i] = wp.vec2(hit.v, 1.0 - hit.u - hit.v)  # Warp's u and v weigh corners 0 and 1
            distances[i] = hit.t


@wp.kernel(enable_backward=False)
def _any(
    first: int,
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    each: int,
    asked: wp.array(dtype=wp.uint8),
    blocked: wp.array(dtype=wp.uint8),
):
    i = first + wp.tid()
    if asked[i] != wp.uint8(0):
        if wp.mesh_query_ray_anyhit(mesh, origins[i // each], directions[i], FAR):
            blocked[i] = wp.uint8(1)


class WarpRays:
    """See :class:`ia_bench.render.rays.RayCaster`."""

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        where = str(device)  # Warp knows "cuda", a device without a number; wp.device_from_torch does not
        points = wp.array(mesh.vertices, dtype=wp.vec3, device=where)
        self._mesh = wp.Mesh(points, wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=where))
        self.mesh, self.rays = mesh, 0

    def intersect(
        self, origins: Tensor, directions: Tensor, asked: Tensor | None = None, *, coherent: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See :meth:`ia_bench.render.rays.RayCaster.intersect`."""
        shape, device = directions.shape[:-1], origins.device
        face = torch.full(shape, -1, dtype=torch.int32, device=device)
        barycentric = torch.zeros(*shape, 2, device=device)
        distance = torch.full(shape, torch.inf, device=device)
        self._ask(_nearest, origins, directions, asked, face.reshape(-1), barycentric.reshape(-1, 2), distance.reshape(-1))
        return face.long(), barycentric, distance

    def occluded(self, origins: Tensor, directions: Tensor, asked: Tensor | None = None) -> Tensor:
        """See :meth:`ia_bench.render.rays.RayCaster.occluded`."""
        blocked = torch.zeros(directions.shape[:-1], dtype=torch.uint8, device=origins.device)
        self._ask(_any, origins, directions, asked, blocked.reshape(-1))
        return blocked.bool()

    def _ask(self, kernel: wp.Kernel, origins: Tensor, directions: Tensor, asked: Tensor | None, *results: Tensor) -> None:
        shape, device = directions.shape[:-1], origins.device
        mask = torch.ones(shape, dtype=torch.bool, device=device) if asked is None else asked.contiguous()
        if mask.numel():
            launch(
                kernel, mask.numel(), self._mesh.id, origins.contiguous(), directions.contiguous().reshape(-1, 3),
                mask.numel() // len(origins), mask.view(torch.uint8).reshape(-1), *results, device=device,
            )  # fmt: skip
        self.rays += int(mask.sum())
