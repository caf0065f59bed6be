"""What photographs hardly show follows what is around it: a pixel that sees the surface from the side says little of a texel."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.material.textures import Material, fill_unobserved, smooth_by_looks, splat
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.refinement import OFFSET


def looks(problem: Problem, size: int) -> Tensor:
    """How many photographs look straight at each texel: (size, size), those that see it from the side by their cosine.

    The pixels that show a texel, each times the area that it has at the distance of the surface, over the area of the texel.
    Pixels that the object covers in part are left out, and those that a mask leaves out.
    """
    gbuffer, surface = problem.gbuffer, problem.renderer.surface
    gbuffer = gbuffer.at(torch.nonzero(gbuffer.filled & ~problem.photographs.left_out)[:, 0])
    face = gbuffer.face.long()
    _, position = surface.geometry(face[:, 0], gbuffer.barycentric[:, 0])
    share = pixel_area(problem, gbuffer.view(), position) * size**2 / surface.area_per_uv[face[:, 0]].clamp_min(1e-20)
    points = gbuffer.subsamples
    uv = surface.uv(face, gbuffer.barycentric).reshape(-1, 2)
    mean, count = splat(uv, (share / points).repeat_interleave(points)[:, None], size)
    return mean[..., 0] * count


def pixel_area(problem: Problem, view: Tensor, position: Tensor) -> Tensor:
    """Of a pixel of training views (P,), parallel to the image at the depth of (P, 3) ``position``: (P,), scene units squared."""
    cameras = [each.camera for each in problem.scene.train]
    to_world = torch.stack([torch.from_numpy(camera.to_world).float() for camera in cameras]).to(position)
    focal = torch.tensor([camera.focal[0] * camera.focal[1] for camera in cameras]).to(position)
    depth = -((position - to_world[view, :3, 3]) * to_world[view, :3, 2]).sum(1)
    return depth.square() / focal[view]


def smoothed(material: Material, looks: Tensor, observed: Tensor, even: float) -> Material:
    """The ``material`` with albedo and roughness mixed by :func:`ia_bench.material.textures.smooth_by_looks`.

    Albedos are mixed as log(albedo + OFFSET). Outside of ``observed`` (T, T) bool they are filled from what was so mixed; metallic
    is left alone.
    """
    mixed = smooth_by_looks(torch.cat([torch.log(material.albedo + OFFSET), material.roughness], -1), looks, even)
    albedo, roughness = (mixed[..., :3].exp() - OFFSET).clamp_min(0), mixed[..., 3:]
    return Material(fill_unobserved(albedo, observed), fill_unobserved(roughness, observed), material.metallic)
