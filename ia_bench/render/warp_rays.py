"""NVIDIA Warp as the ray tracer of CUDA devices (it also runs on the CPU, where the tests compare it with Embree)."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from ia_bench.scenes.scene import Mesh

FAR = 1e30


@wp.kernel
def _nearest(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.int32),
    barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=wp.float32),
):
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[i], directions[i], FAR)
    if hit.result:
        faces[i] = hit.face
        barycentrics[i] = wp.vec2(hit.v, 1.0 - hit.u - hit.v)  # Warp's u and v weigh corners 0 and 1
        distances[i] = hit.t


@wp.kernel
def _any(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    blocked: wp.array(dtype=wp.uint8),
):
    i = wp.tid()
    if wp.mesh_query_ray_anyhit(mesh, origins[i], directions[i], FAR):
        blocked[i] = wp.uint8(1)


class WarpRays:
    """See :class:`ia_bench.render.rays.RayCaster`."""

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        wp.config.quiet = True
        wp.init()
        self._device = str(wp.device_from_torch(device))
        points = wp.array(mesh.vertices, dtype=wp.vec3, device=self._device)
        self._mesh = wp.Mesh(points, wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=self._device))
        self.mesh, self.rays = mesh, 0

    def intersect(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See :meth:`ia_bench.render.rays.RayCaster.intersect`."""
        count = len(origins)
        face = torch.full((count,), -1, dtype=torch.int32, device=origins.device)
        barycentric = torch.zeros(count, 2, device=origins.device)
        distance = torch.full((count,), torch.inf, device=origins.device)
        outputs = [wp.from_torch(face), wp.from_torch(barycentric, dtype=wp.vec2), wp.from_torch(distance)]
        wp.launch(_nearest, count, [self._mesh.id, *_vectors(origins, directions), *outputs], device=self._device)
        self.rays += count
        return face.long(), barycentric, distance

    def occluded(self, origins: Tensor, directions: Tensor) -> Tensor:
        """See :meth:`ia_bench.render.rays.RayCaster.occluded`."""
        blocked = torch.zeros(len(origins), dtype=torch.uint8, device=origins.device)
        inputs = [self._mesh.id, *_vectors(origins, directions), wp.from_torch(blocked)]
        wp.launch(_any, len(origins), inputs, device=self._device)
        self.rays += len(origins)
        return blocked.bool()


def _vectors(*tensors: Tensor) -> list[wp.array]:
    return [wp.from_torch(tensor.contiguous(), dtype=wp.vec3) for tensor in tensors]
