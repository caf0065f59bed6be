"""The Monte-Carlo estimator of the paper's equation 3: light and BRDF samples joined by the balance heuristic.

Half of the samples follow the light, half the visible GGX normals. Both come from one randomly shifted lattice per pixel:
its first coordinate is stratified over all the samples of the pixel, each sample alone is uniform, so every point of the
pixel has an unbiased estimate whatever its share of the samples. Directions, densities and visibility carry no gradient:
gradients flow through the radiance of the light, the albedo, and the BRDF's value only ("detached" sampling).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.light.latlong import LatLongSampler, direction_to_texel, normal_bin, texel_to_direction
from ia_bench.material.brdf import F0, dot, normal_reflectance, sample_visible_ggx, specular_lobes, visible_ggx_pdf
from ia_bench.material.textures import fetch

GOLDEN = 0.6180339887498949  # the lattice's second generator is the golden ratio's fraction ...
PLASTIC = 0.7548776662466927  # ... and its third comes from the plastic number (Roberts' R2 sequence)


def lattice(shift: Tensor, points: int, count: int, part: int = 0, parts: int = 1) -> Tensor:
    """Lattice samples of (P, 3) pixel shifts in [0, 1): (P, points, count, 3), uniform in [0, 1)^3, float64.

    Point s of a pixel takes the lattice's entries s, s + points, s + 2 points, ..., so that each spans the whole range. A
    lattice too long for one pass is dealt out to ``parts`` of them: of each point's entries the first pass takes the first, the
    second the second, and so on in turn; ``part`` says which pass this is.
    """
    entry = part + parts * torch.arange(count, dtype=torch.float64, device=shift.device)
    index = (points * entry[:, None] + torch.arange(points, device=shift.device)).reshape(-1)
    generators = torch.stack([index / (parts * points * count), index * GOLDEN, index * PLASTIC], -1)
    samples = torch.remainder(shift[:, None] + generators, 1.0).clamp(max=1 - 2**-24)
    return samples.reshape(len(shift), count, points, 3).transpose(1, 2)


def sample_directions(
    normal: Tensor,
    view: Tensor,
    roughness: Tensor,
    lattice_light: Tensor,
    lattice_brdf: Tensor,
    sampler: LatLongSampler,
) -> tuple[Tensor, Tensor, Tensor]:
    """Draw K/2 directions by each technique for N points: direction (N, K, 3), light texel (N, K), weight (N, K, 1).

    ``normal``, ``view`` (N, 3); ``roughness`` (N, 1); lattices (N, K/2, 3). The weight is the balance heuristic's
    1 / (n_light p_light + n_brdf p_brdf), zero below the horizon; what the mesh occludes is not known here yet.
    """
    height, width = sampler.height, sampler.width
    cell = normal_bin(normal)[:, None]
    texel = sampler.sample(cell, lattice_light[..., 0])
    inside = lattice_light[..., 1:].float()
    to_light = texel_to_direction(texel, inside[..., 0], inside[..., 1], height, width)
    n, o, r = normal[:, None], view[:, None], roughness[:, None]
    reflected = sample_visible_ggx(n, o, r, lattice_brdf[..., :2].float())
    direction = torch.cat([to_light, reflected], 1)
    texel = torch.cat([texel, direction_to_texel(reflected, height, width)], 1)
    count = lattice_light.shape[1]
    pdf = sampler.density(cell, texel)[..., None] + visible_ggx_pdf(n, o, direction, r)
    above = dot(n, direction) > 0
    weight = torch.where(above, 1 / (count * pdf.clamp_min(1e-12)), torch.zeros_like(pdf))
    return direction, texel, weight


def shade_directions(
    normal: Tensor,
    view: Tensor,
    uv: Tensor,
    direction: Tensor,
    texel: Tensor,
    weight: Tensor,
    albedo: Tensor,
    roughness: Tensor,
    radiance: Tensor,
    metallic: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weighted samples: diffuse radiance, specular radiance and albedo of each point, each (N, 3).

    Differentiable in the textures ``albedo`` (T, T, 3), ``roughness`` (T', T', 1), ``metallic`` (T'', T'', 1) or None, and in
    ``radiance`` (H W, 3).
    """
    point_albedo = fetch(albedo, uv)
    point_roughness = fetch(roughness, uv)[:, None]
    incoming = radiance[texel] * weight
    cosine = dot(normal[:, None], direction).clamp_min(0)
    diffuse = point_albedo * (incoming * cosine).sum(1) / math.pi
    base, grazing = specular_lobes(normal[:, None], view[:, None], direction, point_roughness)
    if metallic is None:
        return diffuse, (incoming * (F0 * base + grazing)).sum(1), point_albedo
    point_metallic = fetch(metallic, uv)
    specular = normal_reflectance(point_albedo, point_metallic) * (incoming * base).sum(1) + (incoming * grazing).sum(1)
    return diffuse * (1 - point_metallic), specular, point_albedo
