"""What a point reflects: NeILF++'s material, summed over directions that are spread evenly over the sphere.

    radiance = 4 pi / D sum over d of ((1 - m) b / pi + D_r F V) L(x, w_d) max(n . w_d, 0)

D_r is the Gaussian exp(2 (n . h - 1) / r^4) / (pi r^4), F is Schlick's with F0 = .04 (1 - m) + m b, and V the product over both
directions of .5 / (c (1 - r^2 / 2) + r^2 / 2), c the cosine to the normal.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.material.brdf import F0, normalize
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench_baselines.common.spherical_gaussians.lobes import fibonacci_axes

GRAZING = 1e-8  # added to the square of a half vector's length, which is 0 where light comes from behind


def sphere_directions(count: int, generator: torch.Generator) -> Tensor:
    """``count`` directions of a golden spiral over the sphere, turned at random, (count, 3)."""
    return fibonacci_axes(count).to(generator.device) @ random_rotation(generator).T


def random_rotation(generator: torch.Generator) -> Tensor:
    """A rotation (3, 3), uniform among all: that of a unit quaternion of normal deviates (Shoemake 1992)."""
    quaternion = torch.randn(1, 4, generator=generator, device=generator.device)
    w, x, y, z = normalize(quaternion)[0]
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
    ]
    return torch.stack(rows)


def reflect(
    points: SurfacePoints,
    material: tuple[Tensor, Tensor, Tensor],
    directions: Tensor,
    light: Tensor,
) -> Tensor:
    """Radiance (N, 3) toward the camera.

    Args:
        points: N points.
        material: Base colour (N, 3), roughness (N, 1) and metal (N, 1).
        directions: (D, 3), spread evenly over the sphere.
        light: (N, D, 3) radiance from them; what lies below the horizon does not count.
    """
    colour, roughness, metallic = material
    cos_i = (points.normal @ directions.T).clamp_min(0)  # (N, D)
    diffuse, glossy, grazing = (_weights(points, directions, roughness, cos_i) @ light).unbind(1)  # (N, 3) each
    at_normal = F0 * (1 - metallic) + metallic * colour
    reflected = (1 - metallic) * colour / math.pi * diffuse + at_normal * glossy + (1 - at_normal) * grazing
    return 4 * math.pi / len(directions) * reflected


def _weights(points: SurfacePoints, directions: Tensor, roughness: Tensor, cos_i: Tensor) -> Tensor:
    """(N, 3, D): the cosine, that times D_r V, and that times Schlick's (1 - o . h)^5."""
    cos_o = (points.normal * points.view).sum(1, keepdim=True).clamp_min(0)
    cos_io = points.view @ directions.T
    length = torch.sqrt((2 + 2 * cos_io).clamp_min(0) + GRAZING)
    cos_h = ((cos_i + cos_o) / length).clamp_max(1)  # of a float's rounding above 1
    schlick = (1 - length / 2).clamp_min(0) ** 5
    alpha = roughness * roughness
    distribution = torch.exp(2 * (cos_h - 1) / (alpha * alpha)) / (math.pi * alpha * alpha)
    k = alpha / 2
    lobe = cos_i * distribution * (0.5 / (cos_i * (1 - k) + k)) * (0.5 / (cos_o * (1 - k) + k))
    return torch.stack([cos_i, lobe, lobe * schlick], 1)
