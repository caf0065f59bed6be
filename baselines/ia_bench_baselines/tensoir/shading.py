"""What a point reflects: TensoIR's material, summed over one direction in every cell of a lat-long grid.

    radiance = sum over d of (albedo / pi + D F G / (4 (n . o) (n . w_d))) L(x, w_d) max(n . w_d, 0) dOmega_d

D is GGX with alpha = r^2, G = G_1(n . o) G_1(n . w) with G_1(c) = c / (c (1 - k) + k) and k = (r + 1)^2 / 8, and
F = .04 + .96 * 2^(-(5.55473 o.h + 6.98316) o.h) (Karis 2013).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.light.latlong import row_solid_angles
from ia_bench.material.brdf import F0
from ia_bench.render.gbuffer import SurfacePoints

GRAZING = 1e-8  # added to the square of a half vector's length, which is 0 where light comes from behind


def stratified_directions(rows: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """A direction in every cell of a lat-long grid of ``rows`` x 2 ``rows``, and the cells' solid angles.

    Directions are uniform within their cell, so that sums weighted with its solid angle are unbiased. (D, 3) and (D,).
    """
    device, columns = generator.device, 2 * rows
    edges = torch.cos(math.pi * torch.arange(rows + 1, device=device) / rows)[:, None]
    down, across = torch.rand(2, rows, columns, generator=generator, device=device)
    z = edges[:-1] + (edges[1:] - edges[:-1]) * down
    azimuth = 2 * math.pi * (torch.arange(columns, device=device) + across) / columns
    radius = torch.sqrt((1 - z * z).clamp_min(0))
    directions = torch.stack([radius * torch.cos(azimuth), radius * torch.sin(azimuth), z], -1)
    return directions.reshape(-1, 3), row_solid_angles(rows, columns).to(z).repeat_interleave(columns)


def half_vector(normal: Tensor, view: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """The cosines (n . h) and (o . h), in [0, 1], of half vectors between views o (N, 3) and directions (D, 3): (N, D) each.

    For light from below the horizon, too: were its cosine with the normal cut at 0 here, (n . h) could be more than 1, and D has
    a pole there.
    """
    length = torch.sqrt((2 + 2 * view @ directions.T).clamp_min(0) + GRAZING)  # of o + w, twice (o . h)
    towards = normal @ directions.T + (normal * view).sum(1, keepdim=True)
    return (towards / length).clamp(0, 1), length / 2


def reflect(
    points: SurfacePoints, albedo: Tensor, roughness: Tensor, directions: Tensor, solid_angles: Tensor, light: Tensor
) -> Tensor:
    """Radiance (N, 3) toward the camera.

    Args:
        points: N points.
        albedo: (N, 3).
        roughness: (N, 1), perceptual.
        directions: (D, 3).
        solid_angles: (D,) that they stand for.
        light: (N, D, 3) radiance from them; what lies below the horizon does not count.
    """
    cos_i = (points.normal @ directions.T).clamp_min(0)  # (N, D)
    cos_o = (points.normal * points.view).sum(1, keepdim=True).clamp_min(0)
    cos_h, cos_oh = half_vector(points.normal, points.view, directions)
    alpha2 = roughness**4
    distribution = alpha2 / (math.pi * (1 - cos_h * cos_h * (1 - alpha2)).square())
    k = (roughness + 1) ** 2 / 8
    masking = 1 / (4 * (cos_i * (1 - k) + k) * (cos_o * (1 - k) + k))  # G / (4 (n . o) (n . w))
    fresnel = F0 + (1 - F0) * torch.exp2(-(5.55473 * cos_oh + 6.98316) * cos_oh)
    arriving = cos_i * solid_angles
    weights = torch.stack([arriving / math.pi, arriving * distribution * masking * fresnel], 1)
    diffuse, glossy = (weights @ light).unbind(1)
    return albedo * diffuse + glossy
