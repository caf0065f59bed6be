"""From a prior's correction of what a fit shows in its photographs to the texture of the albedo."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.material.textures import fill_unobserved, splat
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Problem

LEAST = 0.01
"""Added to both sides of a quotient of albedos, so that black ones have one."""


def refined_texture(
    problem: Problem, texture: Tensor, render: Tensor, corrected: Tensor, views: tuple[int, ...], share: float
) -> Tensor:
    """The albedo ``texture`` (T, T, 3) as ``views`` were corrected from ``render`` to ``corrected``, both (V, H, W, 3).

    A texel changes by the factor exp(share * mean of log((corrected + e) / (render + e))) of albedos plus e = LEAST, over the
    pixels that show it and are wholly covered, each weighed by the cosine at which it sees the surface; each channel's mean
    factor is taken out, since no correction is asked about level and cast. Texels that no such pixel shows follow their neighbours.
    """
    part, _ = restrict(problem.gbuffer, views)
    covered = torch.nonzero((part.face >= 0).all(1))[:, 0]
    if not len(covered):
        return texture
    pixel, face, barycentric = part.pixel[covered], part.face[covered].long(), part.barycentric[covered]
    logs = [torch.log(images.to(texture.device).reshape(-1, 3)[pixel].clamp_min(0) + LEAST) for images in (corrected, render)]
    change = logs[0] - logs[1]
    surface, points = problem.renderer.surface, face.shape[1]
    origin = part.origin[pixel // (part.shape[1] * part.shape[2])]
    middle = surface(face[:, 0], barycentric[:, 0], origin)
    toward = origin - middle.position
    cosine = (middle.normal * toward).sum(-1, keepdim=True).clamp_min(0) / toward.norm(dim=-1, keepdim=True)
    change = change - (cosine * change).sum(0) / cosine.sum().clamp_min(1e-12)
    weighed = torch.cat([cosine * change, cosine], 1)[:, None].expand(-1, points, -1).reshape(-1, 4)
    summed, total = splat(surface.uv(face, barycentric).reshape(-1, 2), weighed, len(texture))
    known = (total > 0) & (summed[..., 3] > 0)
    mean = fill_unobserved(summed[..., :3] / summed[..., 3:].clamp_min(1e-12), known)
    return ((texture + LEAST) * torch.exp(share * mean) - LEAST).clamp(0, 1)
