"""A cross-bilateral filter of a noisy image, guided by normals and depth that have no noise.

    out(p) = sum_q w(p, q) in(q) / sum_q w(p, q)
    w(p, q) = exp(-|p - q|^2 / 2 sigma^2)  max(0, n_p.n_q)^128  exp(-|z_p - z_q| / (|dz_p.(q - p)| + epsilon))

with the edge-stopping functions of SVGF (Schied et al. 2017). The weights carry no gradient; what is filtered does.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

NORMAL_POWER = 128.0
DEPTH_SLACK = 1e-2  # epsilon, as a share of the mean depth: what a pixel of a curved surface may be off its tangent plane
REACH = 2.0  # the window ends at so many sigmas


@dataclass(frozen=True)
class Guides:
    """What is known of N pixels of one image without noise.

    Attributes:
        row: (N,) int64.
        column: (N,) int64.
        normal: (N, 3), unit length.
        depth: (N, 1), distance from the camera.
        shape: Height and width of the image.
    """

    row: Tensor
    column: Tensor
    normal: Tensor
    depth: Tensor
    shape: tuple[int, int]


def denoise(values: Tensor, guides: Guides, sigma: float) -> Tensor:
    """Filter ``values`` (N, C) with a width of ``sigma`` pixels; 0 leaves them as they are.

    Pixels of the image that are not among the N have no part in it.
    """
    radius = round(REACH * sigma)
    if radius == 0:
        return values
    place, weight = _weights(guides, sigma, radius)
    return (values[place] * weight[..., None]).sum(1) / weight.sum(1, keepdim=True)


@torch.no_grad()
def _weights(guides: Guides, sigma: float, radius: int) -> tuple[Tensor, Tensor]:
    """The neighbours (N, K) of every pixel, itself among them, and their weights; an absent one is pixel 0 with weight 0."""
    height, width = guides.shape
    device = guides.row.device
    where = torch.full((height + 2 * radius, width + 2 * radius), -1, dtype=torch.long, device=device)
    where[guides.row + radius, guides.column + radius] = torch.arange(len(guides.row), device=device)
    line = torch.arange(-radius, radius + 1, device=device)
    down, across = (grid.reshape(-1) for grid in torch.meshgrid(line, line, indexing="ij"))
    place = where[guides.row[:, None] + radius + down, guides.column[:, None] + radius + across]
    there, place = place >= 0, place.clamp_min(0)
    slope = _slope(guides, where, radius)  # (N, 2)
    expected = (slope[:, :1] * down + slope[:, 1:] * across).abs()
    difference = (guides.depth[place, 0] - guides.depth).abs()
    cosine = (guides.normal[place] * guides.normal[:, None]).sum(-1).clamp_min(0)
    near = torch.exp(-(down.square() + across.square()) / (2 * sigma**2))
    depth = torch.exp(-difference / (expected + DEPTH_SLACK * guides.depth.mean()))
    return place, near * cosine**NORMAL_POWER * depth * there


def _slope(guides: Guides, where: Tensor, radius: int) -> Tensor:
    """Change of the depth per pixel, down and across, (N, 2): by the nearer in depth of both neighbours, 0 where there is none."""
    row, column = guides.row + radius, guides.column + radius
    slopes = []
    for down, across in ((1, 0), (0, 1)):
        sides = []
        for sign in (1, -1):
            other = where[row + sign * down, column + sign * across]
            change = sign * (guides.depth[other.clamp_min(0), 0] - guides.depth[:, 0])
            sides.append(torch.where(other >= 0, change, torch.full_like(change, torch.inf)))
        nearer = torch.where(sides[0].abs() < sides[1].abs(), sides[0], sides[1])
        slopes.append(torch.where(nearer.isfinite(), nearer, torch.zeros_like(nearer)))
    return torch.stack(slopes, -1)
