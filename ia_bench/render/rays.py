"""Rays against a fixed mesh: Embree on the CPU, Warp on CUDA."""

from __future__ import annotations

import torch

from ia_bench.render.ray_caster import RayCaster
from ia_bench.scenes.scene import Mesh

__all__ = ["RayCaster", "make_rays"]


def make_rays(mesh: Mesh, device: torch.device) -> RayCaster:
    """The exact tracer of the device: Embree on the CPU, Warp on CUDA."""
    if device.type == "cpu":
        from ia_bench.render.embree import EmbreeRays

        return EmbreeRays(mesh)
    from ia_bench.render.warp_rays import WarpRays

    return WarpRays(mesh, device)
