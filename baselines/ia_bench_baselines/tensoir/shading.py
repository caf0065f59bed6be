"""What a point reflects: TensoIR's material, summed over directions of light.

    radiance = sum over d of (albedo / pi + D F G / (4 (n . o) (n . w_d))) L(x, w_d) max(n . w_d, 0) dOmega_d

D is GGX with alpha = r^2, G = G_1(n . o) G_1(n . w) with G_1(c) = c / (c (1 - k) + k) and k = (r + 1)^2 / 8, and
F = .04 + .96 * 2^(-(5.55473 o.h + 6.98316) o.h) (Karis 2013).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.material.brdf import F0
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench_baselines.common.half_vectors import cosines, half_vector


def reflect(points: SurfacePoints, albedo: Tensor, roughness: Tensor, directions: Tensor, weights: Tensor, light: Tensor) -> Tensor:
    """Radiance (N, 3) toward the camera.

    Args:
        points: N points.
        albedo: (N, 3).
        roughness: (N, 1), perceptual.
        directions: (N, D, 3).
        weights: (N, D), the solid angles that they stand for.
        light: (N, D, 3) radiance from them; what lies below the horizon does not count.
    """
    cosine = cosines(points.normal, directions)
    cos_o = (points.normal * points.view).sum(1, keepdim=True).clamp_min(0)
    cos_h, cos_oh = half_vector(points.normal, points.view, directions, cosine)
    cos_i = cosine.clamp_min(0)
    alpha2 = roughness**4
    distribution = alpha2 / (math.pi * (1 - cos_h * cos_h * (1 - alpha2)).square())
    k = (roughness + 1) ** 2 / 8
    masking = 1 / (4 * (cos_i * (1 - k) + k) * (cos_o * (1 - k) + k))  # G / (4 (n . o) (n . w))
    fresnel = F0 + (1 - F0) * torch.exp2(-(5.55473 * cos_oh + 6.98316) * cos_oh)
    arriving = cos_i * weights
    lobes = torch.stack([arriving / math.pi, arriving * distribution * masking * fresnel], 1)
    diffuse, glossy = (lobes @ light).unbind(1)
    return albedo * diffuse + glossy
