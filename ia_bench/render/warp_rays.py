"""NVIDIA Warp as the ray tracer of CUDA devices (it also runs on the CPU, where the tests compare it with Embree)."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from ia_bench.common.warp_launch import launch
from ia_bench.render.ray_caster import RayCaster
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


class WarpRays(RayCaster):
    """The tracer of CUDA devices."""

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        super().__init__(mesh)
        where = str(device)  # Warp knows "cuda", a device without a number; wp.device_from_torch does not
        points = wp.array(mesh.vertices, dtype=wp.vec3, device=where)
        self._mesh = wp.Mesh(points, wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=where))

    def _trace(
        self, nearest: bool, origins: Tensor, directions: Tensor, asked: Tensor | None, coherent: bool, *results: Tensor
    ) -> None:
        count = len(directions)
        mask = torch.ones(count, dtype=torch.uint8, device=origins.device) if asked is None else asked
        kernel = _nearest if nearest else _any
        launch(kernel, count, self._mesh.id, origins, directions, count // len(origins), mask, *results, device=origins.device)
