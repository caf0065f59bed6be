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
    faces: wp.array(dtype=wp.int32),
    barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=wp.float32),
):
    i = first + wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[i], directions[i], FAR)
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
        where = str(wp.device_from_torch(device))
        points = wp.array(mesh.vertices, dtype=wp.vec3, device=where)
        self._mesh = wp.Mesh(points, wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=where))
        self.mesh, self.rays = mesh, 0

    def intersect(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See :meth:`ia_bench.render.rays.RayCaster.intersect`."""
        count, device = len(origins), origins.device
        face = torch.full((count,), -1, dtype=torch.int32, device=device)
        barycentric = torch.zeros(count, 2, device=device)
        distance = torch.full((count,), torch.inf, device=device)
        rays = origins.contiguous(), directions.contiguous()
        launch(_nearest, count, self._mesh.id, *rays, face, barycentric, distance, device=device)
        self.rays += count
        return face.long(), barycentric, distance

    def occluded(self, origins: Tensor, directions: Tensor, asked: Tensor | None = None) -> Tensor:
        """See :meth:`ia_bench.render.rays.RayCaster.occluded`."""
        shape, device = directions.shape[:-1], origins.device
        mask = torch.ones(shape, dtype=torch.bool, device=device) if asked is None else asked
        blocked = torch.zeros(shape, dtype=torch.uint8, device=device)
        if mask.numel():
            launch(
                _any, mask.numel(), self._mesh.id, origins.contiguous(), directions.reshape(-1, 3).contiguous(),
                mask.numel() // len(origins), mask.contiguous().view(torch.uint8).reshape(-1), blocked.reshape(-1), device=device,
            )  # fmt: skip
        self.rays += int(mask.sum())
        return blocked.bool()
