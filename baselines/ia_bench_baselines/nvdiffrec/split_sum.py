"""Split-sum shading (Karis 2013): the integral of light times BRDF as the product of two integrals.

    L_o = k_d (1 - m) E(n) / pi + L(R, r) (F0 A(r, n.v) + B(r, n.v)),    F0 = .04 (1 - m) + m k_d

E is irradiance, L the light filtered by the lobe around the mirror direction R, A and B what the lobe reflects of a white light. No
point is shadowed and no light is reflected twice: that is what the method is.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.material.brdf import F0, MIN_COSINE, MIN_ROUGHNESS, dot, normalize, sample_visible_ggx, smith_g1, smith_visibility
from ia_bench_baselines.nvdiffrec.prefilter import PrefilteredLight

GRID, SAMPLES = 32, 512
GOLDEN = 0.6180339887498949  # fraction of the golden ratio: its multiples fill [0, 1] evenly


@functools.cache
def white_reflectance() -> Tensor:
    """A and B of a lobe under white light with Schlick's Fresnel term, (2, GRID, GRID): rows are roughness, columns n.v, 0 to 1.

    Each sample is drawn from the visible normals, so that it weighs G2 / G1 (Heitz 2018).
    """
    values = torch.linspace(0, 1, GRID)
    grids = torch.meshgrid(values.clamp_min(MIN_ROUGHNESS), values.clamp_min(MIN_COSINE), indexing="ij")
    roughness, cosine = (grid.reshape(-1, 1, 1).expand(-1, SAMPLES, 1) for grid in grids)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(*cosine.shape[:2], 3)
    view = torch.cat([torch.sqrt(1 - cosine * cosine), torch.zeros_like(cosine), cosine], -1)
    index = torch.arange(SAMPLES, dtype=torch.float64)
    u = torch.stack([(index + 0.5) / SAMPLES, torch.remainder((index + 0.5) * GOLDEN, 1)], -1).float()
    incident = sample_visible_ggx(normal, view, roughness, u.expand(*cosine.shape[:2], 2))
    cos_i, alpha = incident[..., 2:], roughness * roughness
    masked = 4 * cosine * cos_i.clamp_min(MIN_COSINE) * smith_visibility(cos_i.clamp_min(MIN_COSINE), cosine, alpha)
    weight = torch.where(cos_i > 0, masked / smith_g1(cosine, alpha), torch.zeros_like(masked))
    grazing = (1 - dot(view, normalize(view + incident)).clamp(0, 1)) ** 5
    scale, bias = ((weight * part).mean(1).reshape(GRID, GRID) for part in (1 - grazing, grazing))
    return torch.stack([scale, bias])


def shade(
    light: PrefilteredLight, normal: Tensor, view: Tensor, base_colour: Tensor, roughness: Tensor, metallic: Tensor
) -> Tensor:
    """Radiance (N, 3) toward unit ``view`` (N, 3) of points with unit ``normal`` (N, 3).

    ``base_colour`` (N, 3) linear, perceptual ``roughness`` and ``metallic`` (N, 1), all in [0, 1]. Differentiable in these and in
    the light.
    """
    cosine = dot(normal, view)
    mirrored = normalize(2 * cosine * normal - view)
    table = white_reflectance().to(normal.device)
    place = torch.cat([cosine.clamp(0, 1), roughness], -1) * (2 * (GRID - 1) / GRID) - (GRID - 1) / GRID
    scale, bias = grid_sample(table[None], place[None, :, None], align_corners=False)[0, :, :, :1].unbind(0)
    reflectance = F0 * (1 - metallic) + metallic * base_colour
    diffuse = base_colour * (1 - metallic) * light.irradiance(normal)
    return diffuse + light.glossy(mirrored, roughness) * (reflectance * scale + bias)
