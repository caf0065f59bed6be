"""What a point reflects: NeILF++'s material, summed over directions of which each stands for a solid angle.

    radiance = sum over d of dOmega_d ((1 - m) b / pi + D_r F V) L(x, w_d) max(n . w_d, 0)

D_r is the Gaussian exp(2 (n . h - 1) / r^4) / (pi r^4), F is Schlick's with F0 = .04 (1 - m) + m b, and V the product over both
directions of .5 / (c (1 - r^2 / 2) + r^2 / 2), c the cosine to the normal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from ia_bench.material.brdf import F0, sample_visible_ggx, visible_ggx_pdf
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench_baselines.common.half_vectors import cosines, half_vector
from ia_bench_baselines.common.spherical_gaussians.lobes import fibonacci_axes


class Quadrature(NamedTuple):
    """D directions of each of N points, some of them shared.

    Attributes:
        directions: (A, 3), all of them.
        row: (N, D), which of them each point looks into.
        weight: (N, D), the solid angle that each stands for.
    """

    directions: Tensor
    row: Tensor
    weight: Tensor

    def of_points(self) -> Tensor:
        """The directions of each point, (N, D, 3)."""
        return self.directions[self.row]


@torch.no_grad()
def quadrature(points: SurfacePoints, roughness: Tensor, shared: int, glossy: int, generator: torch.Generator) -> Quadrature:
    """``shared`` directions over the sphere that all points look into, and ``glossy`` ones of each, by GGX (balance heuristic)."""
    number, device = len(points.normal), points.normal.device
    u = torch.rand(number, glossy, 2, generator=generator, device=device)
    u[..., 0] = (torch.arange(glossy, device=device) + u[..., 0]) / max(glossy, 1)
    normal, view, rough = points.normal[:, None], points.view[:, None], roughness[:, None]
    own = sample_visible_ggx(normal, view, rough, u)
    directions = torch.cat([sphere_directions(shared, generator), own.reshape(-1, 3)])
    mine = shared + torch.arange(number * glossy, device=device).reshape(number, glossy)
    row = torch.cat([torch.arange(shared, device=device).expand(number, -1), mine], 1)
    density = shared / (4 * math.pi) + glossy * visible_ggx_pdf(normal, view, directions[row], rough)[..., 0]
    return Quadrature(directions, row, 1 / density)


def sphere_directions(count: int, generator: torch.Generator) -> Tensor:
    """``count`` directions of a golden spiral over the sphere, turned at random, (count, 3)."""
    return fibonacci_axes(count).to(generator.device) @ random_rotation(generator).T


def random_rotation(generator: torch.Generator) -> Tensor:
    """A rotation (3, 3), uniform among all: that of a unit quaternion of normal deviates (Shoemake 1992)."""
    w, x, y, z = torch.randn(4, generator=generator, device=generator.device).tolist()
    return torch.tensor(Rotation.from_quat([x, y, z, w]).as_matrix(), dtype=torch.float32, device=generator.device)


def reflect(
    points: SurfacePoints, material: tuple[Tensor, Tensor, Tensor], directions: Tensor, weights: Tensor, light: Tensor
) -> Tensor:
    """Radiance (N, 3) toward the camera.

    Args:
        points: N points.
        material: Base colour (N, 3), roughness (N, 1) and metal (N, 1).
        directions: (N, D, 3).
        weights: (N, D), the solid angles that they stand for.
        light: (N, D, 3) radiance from them; what lies below the horizon does not count.
    """
    colour, roughness, metallic = material
    cosine = cosines(points.normal, directions)
    lobes = _lobes(points, directions, roughness, cosine) * (weights * cosine.clamp_min(0))[:, None]
    diffuse, glossy, grazing = (lobes @ light).unbind(1)  # (N, 3) each
    at_normal = F0 * (1 - metallic) + metallic * colour
    return (1 - metallic) * colour / math.pi * diffuse + at_normal * glossy + (1 - at_normal) * grazing


def _lobes(points: SurfacePoints, directions: Tensor, roughness: Tensor, cos_i: Tensor) -> Tensor:
    """(N, 3, D): 1, D_r V, and that times Schlick's (1 - o . h)^5."""
    cos_o = (points.normal * points.view).sum(1, keepdim=True).clamp_min(0)
    cos_h, cos_oh = half_vector(points.normal, points.view, directions, cos_i)
    schlick = (1 - cos_oh).clamp_min(0) ** 5
    alpha = roughness * roughness
    distribution = torch.exp(2 * (cos_h - 1) / (alpha * alpha)) / (math.pi * alpha * alpha)
    k = alpha / 2
    lobe = distribution * (0.5 / (cos_i.clamp_min(0) * (1 - k) + k)) * (0.5 / (cos_o * (1 - k) + k))
    return torch.stack([torch.ones_like(lobe), lobe, lobe * schlick], 1)
