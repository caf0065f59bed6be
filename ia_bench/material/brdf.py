"""The simplified Disney BRDF of the paper (its equation 2): Lambert plus GGX, as pure functions of torch tensors.

``f = albedo / pi + D G F / (4 (n.o)(n.i))`` with the GGX distribution, alpha = roughness^2, the *height-correlated*
Smith term (Heitz 2014), and Schlick's Fresnel with F0 = 0.04. There is no energy compensation and no coupling between
the lobes (a Principled BSDF takes from the diffuse part what the coat reflects; docs/verification.md measures that).
Vectors are unit length with a last axis of 3; roughness and cosines have a last axis of 1 or none, and broadcast.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key

COAT, COAT_SAMPLES = 32, 1024  # entries along a side of the table of the coat, and directions that one is the mean of
F0 = 0.04  # reflectance at normal incidence of a dielectric with IOR 1.5
MIN_ROUGHNESS = 0.03  # alpha = 9e-4: the narrowest lobe that float32 resolves without loss
MIRROR = 1e-30  # alpha = 0 at the mirror direction itself is 0 / this, not 0 / 0
GOLDEN = 0.6180339887498949  # fraction of the golden ratio: its multiples fill [0, 1] evenly
PLASTIC = 0.7548776662466927  # likewise beside them, from the plastic number (Roberts' R2 sequence)
MIN_COSINE = 1e-4  # grazing cosines are held here, where a lobe has no area any more


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Inner product over the last axis, which is kept with length 1."""
    return (a * b).sum(-1, keepdim=True)


def normalize(a: Tensor) -> Tensor:
    """Unit vectors over the last axis; a zero vector stays zero."""
    return a * torch.rsqrt(dot(a, a).clamp_min(1e-20))


def ggx_ndf(normal: Tensor, half: Tensor, alpha: Tensor) -> Tensor:
    """GGX distribution of normals D(h), per steradian; zero below the horizon.

    1 - (n.h)^2 is taken as |h - (n.h) n|^2, so that narrow lobes keep their precision where n.h is within an ulp of 1. A
    perfect mirror (alpha = 0) has no density: 0 everywhere.
    """
    cos_h = dot(normal, half)
    tangential = half - cos_h * normal
    above = cos_h > 0
    spread = (dot(tangential, tangential) + alpha * alpha * cos_h * cos_h).clamp_min(MIRROR)
    height = alpha / torch.where(above, spread, 1.0)  # 1 where there is no half vector (incident = -view): a finite gradient
    return torch.where(above, height * height / math.pi, torch.zeros_like(spread))


def smith_visibility(cos_i: Tensor, cos_o: Tensor, alpha: Tensor) -> Tensor:
    """Height-correlated Smith masking-shadowing divided by 4 (n.i)(n.o)."""
    alpha2 = alpha * alpha
    towards_i = cos_o * torch.sqrt(alpha2 + (1 - alpha2) * cos_i * cos_i)
    towards_o = cos_i * torch.sqrt(alpha2 + (1 - alpha2) * cos_o * cos_o)
    return 0.5 / (towards_i + towards_o)


def smith_g1(cosine: Tensor, alpha: Tensor) -> Tensor:
    """Smith masking of one direction, in [0, 1]."""
    alpha2 = alpha * alpha
    return 2 * cosine / (cosine + torch.sqrt(alpha2 + (1 - alpha2) * cosine * cosine))


def specular_brdf_cosine(normal: Tensor, view: Tensor, incident: Tensor, roughness: Tensor) -> Tensor:
    """Specular BRDF of a dielectric times (n.i), per steradian; zero for incident directions below the horizon.

    ``roughness`` is perceptual, in [MIN_ROUGHNESS, 1]. Differentiable in all arguments.
    """
    value, cosine = microfacets(normal, view, incident, roughness)
    return value * fresnel_schlick(cosine)


def microfacets(normal: Tensor, view: Tensor, incident: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """D G / (4 (n.o)(n.i)) times (n.i), and (o.h)."""
    alpha = roughness * roughness
    half = normalize(view + incident)
    cos_i = dot(normal, incident)
    lit = cos_i > 0
    cos_i, cos_o = cos_i.clamp_min(MIN_COSINE), dot(normal, view).clamp_min(MIN_COSINE)
    value = ggx_ndf(normal, half, alpha) * smith_visibility(cos_i, cos_o, alpha) * cos_i
    return torch.where(lit, value, torch.zeros_like(value)), dot(view, half).clamp(0, 1)


def fresnel_schlick(cosine: Tensor) -> Tensor:
    """Schlick's approximation with F0 = 0.04; ``cosine`` is (o.h), in [0, 1]."""
    return F0 + (1 - F0) * (1 - cosine) ** 5


def tangent_frame(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit tangents that complete ``normal`` to a right-handed frame (Duff et al. 2017; no branch, no pole)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return tangent, torch.stack([b, sign + y * y * a, -y], -1)


def sample_visible_ggx(normal: Tensor, view: Tensor, roughness: Tensor, u: Tensor) -> Tensor:
    """Incident directions from the visible normals (Dupuy and Benyoub 2023, spherical caps).

    ``u`` (..., 2) uniform in [0, 1). The direction may fall below the horizon; its density is :func:`visible_ggx_pdf`.
    """
    alpha = roughness * roughness
    tangent, bitangent = tangent_frame(normal)
    local_z = dot(normal, view).clamp_min(MIN_COSINE)
    local = torch.cat([dot(tangent, view) * alpha, dot(bitangent, view) * alpha, local_z], -1)
    local = normalize(local)
    azimuth = 2 * math.pi * u[..., 0:1]
    cos_cap = (1 - u[..., 1:2]) * (1 + local[..., 2:3]) - local[..., 2:3]
    sin_cap = torch.sqrt((1 - cos_cap * cos_cap).clamp(0, 1))
    cap = torch.cat([sin_cap * torch.cos(azimuth), sin_cap * torch.sin(azimuth), cos_cap], -1)
    stretched = cap + local
    micro = normalize(torch.cat([stretched[..., :2] * alpha, stretched[..., 2:3].clamp_min(0)], -1))
    half = micro[..., 0:1] * tangent + micro[..., 1:2] * bitangent + micro[..., 2:3] * normal
    return 2 * dot(view, half) * half - view


def visible_ggx_pdf(normal: Tensor, view: Tensor, incident: Tensor, roughness: Tensor) -> Tensor:
    """Density per steradian of :func:`sample_visible_ggx`.

    It holds for every pair: (o.h) cannot be negative, but near incident = -view rounding gives it either sign, and a density
    of zero for a direction that was drawn would give it all the weight of the other technique.
    """
    alpha = roughness * roughness
    half = normalize(view + incident)
    cos_o = dot(normal, view).clamp_min(MIN_COSINE)
    return ggx_ndf(normal, half, alpha) * smith_g1(cos_o, alpha) / (4 * cos_o)


@functools.cache
def coat_reflectance() -> Tensor:
    """The directional albedo of the specular lobe, (COAT, COAT): rows are roughness, columns the cosine, both from 0 to 1.

    So much the lobe reflects in all, and keeps from the diffuse one below it. The table is kept in the cache, for this code.
    """
    key = content_key("coat", Path(__file__).read_text(encoding="utf-8"))
    return Cache().kept(key, lambda: {"table": _coat_table()})["table"]


def _coat_table() -> Tensor:
    values = torch.linspace(0, 1, COAT)
    roughness, cosine = (grid[..., None, None] for grid in torch.meshgrid(values, values, indexing="ij"))
    cosine = cosine.clamp_min(MIN_COSINE)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(COAT, COAT, COAT_SAMPLES, 3)
    view = torch.cat([torch.sqrt(1 - cosine * cosine), torch.zeros_like(cosine), cosine], -1).expand(normal.shape)
    index = torch.arange(COAT_SAMPLES, dtype=torch.float64)
    u = torch.stack([(index + 0.5) / COAT_SAMPLES, torch.remainder((index + 0.5) * GOLDEN, 1)], -1).float()
    rough = roughness.clamp_min(MIN_ROUGHNESS).expand(COAT, COAT, COAT_SAMPLES, 1)
    incident = sample_visible_ggx(normal, view, rough, u)
    density = visible_ggx_pdf(normal, view, incident, rough)
    value = specular_brdf_cosine(normal, view, incident, rough) / density.clamp_min(1e-12)
    return torch.where(density > 0, value, torch.zeros_like(value)).mean(2)[..., 0]
