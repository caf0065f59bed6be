"""Pairs of neighbouring surface points found in image space, where UV seams do not exist."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.methods.contract import Problem


@dataclass(frozen=True)
class Neighbours:
    """For each G-buffer pixel its right and its lower neighbour on the same piece of surface.

    ``index`` (P, 2) int64 G-buffer entries, a pixel's own entry where it has no such neighbour; ``similarity`` (P, 2) in
    [0, 1], near 1 where both pixels have the same log radiance, 0 for no neighbour; ``uv`` (P, 2) of each pixel's first hit.
    """

    index: Tensor
    similarity: Tensor
    uv: Tensor


@torch.no_grad()
def find_neighbours(problem: Problem, images: Tensor, scale: float) -> Neighbours:
    """Pair neighbouring pixels of (P, 3) training radiance.

    At a difference of ``scale`` in log radiance the similarity is 1/e. Pixels whose normals differ by more than 37
    degrees, or whose distance jumps, are no pair.
    """
    gbuffer, surface = problem.gbuffer, problem.renderer.surface
    _, height, width = gbuffer.shape
    first = (gbuffer.face >= 0).int().argmax(1)
    rows = torch.arange(len(first), device=first.device)
    points = surface(gbuffer.face[rows, first].long(), gbuffer.barycentric[rows, first], gbuffer.seen_from())
    entry = gbuffer.entry_of_pixel()
    column, row = gbuffer.pixel % width, gbuffer.pixel // width % height
    log_radiance = torch.log(images.mean(-1) + 1e-3 * images.mean().clamp_min(1e-12))
    spacing = None
    index, similarity = [], []
    for inside, step in ((column < width - 1, 1), (row < height - 1, width)):
        other = torch.where(inside, entry[(gbuffer.pixel + step).clamp(max=len(entry) - 1)], -1)
        other = torch.where(other < 0, rows, other)
        distance = (points.position - points.position[other]).norm(dim=-1)
        if spacing is None:
            real = distance[other != rows]
            spacing = real.median() if len(real) else distance.new_tensor(1.0)
        same = (other != rows) & (distance < 4 * spacing)
        same &= (points.normal * points.normal[other]).sum(-1) > 0.8
        change = (log_radiance - log_radiance[other]) / scale
        index.append(torch.where(same, other, rows))
        similarity.append(torch.where(same, torch.exp(-change * change), torch.zeros_like(change)))
    return Neighbours(torch.stack(index, 1), torch.stack(similarity, 1), points.uv)
