"""``context``: what photographs hardly show follows what is around it; a pixel that sees a surface from the side says little."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import Weight
from ia_bench.material.textures import Material, fill_unobserved, smooth_by_view_count, splat
from ia_bench.methods.contract import FitState, Problem, Regulariser
from ia_bench.methods.regularisers.fusion import OFFSET


@dataclass(frozen=True)
class Context(Regulariser):
    """Each texel keeps n^2 / (n^2 + ``view_count``^2) of its albedo and roughness and takes the rest from around it.

    n is :func:`effective_view_count`. Albedos are mixed as log(albedo + OFFSET); metallic is left alone.

    Attributes:
        view_count: At how many photographs that look straight at it a texel keeps half.
    """

    view_count: Weight = 0.2  # chosen on development scenes (docs/log/few-photographs.md)
    completes = True

    def apply(self, material: Material, state: FitState) -> Material:
        """See the class. What no photograph shows is filled from what was so mixed."""
        if not self.view_count:
            return material
        count = effective_view_count(state.problem, len(state.observed))
        texture = torch.cat([torch.log(material.albedo + OFFSET), material.roughness], -1)
        mixed = smooth_by_view_count(texture, count, self.view_count)
        albedo, roughness = (mixed[..., :3].exp() - OFFSET).clamp_min(0), mixed[..., 3:]
        albedo, roughness = (fill_unobserved(part, state.observed) for part in (albedo, roughness))
        return Material(albedo, roughness, material.metallic)


def effective_view_count(problem: Problem, size: int) -> Tensor:
    """How many photographs look straight at each texel: (size, size), those that see it from the side by their cosine.

    The pixels that show a texel, each times the area that it has at the distance of the surface, over the area of the texel.
    Pixels that the object covers in part are left out, and those that a mask leaves out.
    """
    gbuffer, surface = problem.gbuffer, problem.renderer.surface
    gbuffer = gbuffer.at(torch.nonzero(gbuffer.filled & ~problem.photographs.left_out)[:, 0])
    face = gbuffer.face.long()
    _, position = surface.geometry(face[:, 0], gbuffer.barycentric[:, 0])
    cameras, view = [each.camera for each in problem.scene.train], gbuffer.view()
    to_world = torch.stack([torch.from_numpy(camera.to_world).float() for camera in cameras]).to(position)
    focal = torch.tensor([camera.focal[0] * camera.focal[1] for camera in cameras]).to(position)
    depth = -((position - to_world[view, :3, 3]) * to_world[view, :3, 2]).sum(1)
    pixel_area = depth.square() / focal[view]  # parallel to the image
    share = pixel_area * size**2 / surface.area_per_uv[face[:, 0]].clamp_min(1e-20)
    points = gbuffer.subsamples
    uv = surface.uv(face, gbuffer.barycentric).reshape(-1, 2)
    mean, count = splat(uv, (share / points).repeat_interleave(points)[:, None], size)
    return mean[..., 0] * count
