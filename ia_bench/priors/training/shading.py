"""Direct light at many points under many small lights at once: MIS of light and visible-normal samples, shadows by Embree.

The estimator is that of :mod:`ia_bench.render.estimator`; it differs in its light: one luminance table per light without
the tables by surface normal (an image has a light of its own here, so tables are built for every image), and discs that
are sampled as one more texel each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.light.latlong import direction_to_texel, row_solid_angles, texel_to_direction
from ia_bench.material.brdf import dot, sample_visible_ggx, specular_brdf_cosine, tangent_frame, visible_ggx_pdf
from ia_bench.priors.training.lights import Light
from ia_bench.render.rays import RayCaster

CHUNK_SAMPLES = 32_768  # directions shaded at a time: few enough for the cache, one shape for the compiler
OFFSET = 2e-4  # of secondary rays off the surface; objects have radius 1


@dataclass(frozen=True)
class LightTables:
    """Several lights stacked for sampling: map ``radiance`` (L T, 3) and its ``density`` (L T,) per steradian, discs
    (L, D, ...) with their ``disc_density`` (L, D), and ``cumulative`` (L (T + D),) float64, light l's offset by l."""

    height: int
    width: int
    radiance: Tensor
    density: Tensor
    direction: Tensor
    cosine: Tensor
    emission: Tensor
    disc_density: Tensor
    cumulative: Tensor

    @classmethod
    def build(cls, lights: Sequence[Light]) -> LightTables:
        """Tables in proportion to mean radiance times solid angle, of texels and discs alike."""
        height, width, _ = lights[0].radiance.shape
        radiance = torch.stack([light.radiance for light in lights]).reshape(len(lights), -1, 3)
        cosine = torch.stack([light.cosine for light in lights])
        emission = torch.stack([light.emission for light in lights])
        area = row_solid_angles(height, width).repeat_interleave(width)
        disc_area = 2 * math.pi * (1 - cosine.double()).clamp_min(0)
        power = torch.cat([radiance.double().mean(-1) * area, emission.double().mean(-1) * disc_area], 1)
        chance = power / power.sum(1, keepdim=True)
        texels = radiance.shape[1]
        cumulative = chance.cumsum(1)
        cumulative = cumulative / cumulative[:, -1:] + torch.arange(len(lights))[:, None]
        return cls(
            height,
            width,
            radiance.reshape(-1, 3),
            (chance[:, :texels] / area).float().reshape(-1),
            torch.stack([light.direction for light in lights]),
            cosine,
            emission,
            (chance[:, texels:] / disc_area.clamp_min(1e-12)).float(),
            cumulative.reshape(-1),
        )


def draw_samples(
    normal: Tensor,
    view: Tensor,
    geometric: Tensor,
    roughness: Tensor,
    light: Tensor,
    u: Tensor,
    height: int,
    width: int,
    radiance: Tensor,
    density: Tensor,
    disc_direction: Tensor,
    disc_cosine: Tensor,
    disc_emission: Tensor,
    disc_density: Tensor,
    cumulative: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """K directions for N points, the first half by the light, the second by the BRDF, and what each adds if unoccluded.

    ``normal``, ``view``, ``geometric`` (N, 3); ``roughness`` (N, 1); ``light`` (N,) index; ``u`` (N, K, 3) uniform.
    Returns directions (N, K, 3), weighted radiance (N, K, 3), zero below the surface, and (N, K, 2): cosine / pi, and
    the specular BRDF times the cosine.
    """
    count = u.shape[1] // 2
    texels, discs = height * width, disc_cosine.shape[1]
    # light sampling: an entry of the light's table is a texel or a disc
    u_light = u[:, :count]
    entry = torch.searchsorted(cumulative, light[:, None] + u_light[..., 0].double(), right=True)
    entry = (entry - light[:, None] * (texels + discs)).clamp(0, texels + discs - 1)
    to_texel = texel_to_direction(entry.clamp(max=texels - 1), u_light[..., 1], u_light[..., 2], height, width)
    which = light[:, None] * discs + (entry - texels).clamp_min(0)
    axis, edge = disc_direction.reshape(-1, 3)[which], disc_cosine.reshape(-1)[which][..., None]
    tangent, bitangent = tangent_frame(axis)
    cos_disc = 1 - u_light[..., 1:2] * (1 - edge)
    sin_disc = torch.sqrt((1 - cos_disc * cos_disc).clamp_min(0))
    angle = 2 * math.pi * u_light[..., 2:3]
    to_disc = sin_disc * (torch.cos(angle) * tangent + torch.sin(angle) * bitangent) + cos_disc * axis
    to_light = torch.where((entry < texels)[..., None], to_texel, to_disc)
    # BRDF sampling
    n, o, r = normal[:, None], view[:, None], roughness[:, None]
    reflected = sample_visible_ggx(n, o, r, u[:, count:, :2])
    direction = torch.cat([to_light, reflected], 1)
    # what the light sends from there, and both densities
    texel = light[:, None] * texels + direction_to_texel(direction, height, width)
    incoming, light_pdf = radiance[texel], density[texel]
    for disc in range(discs):
        inside = dot(direction, disc_direction[light, disc][:, None]) > disc_cosine[light, disc][:, None, None]
        incoming = incoming + inside * disc_emission[light, disc][:, None]
        light_pdf = light_pdf + inside[..., 0] * disc_density[light, disc][:, None]
    pdf = light_pdf[..., None] + visible_ggx_pdf(n, o, direction, r)
    cosine = dot(n, direction)
    above = (cosine > 0) & (dot(geometric[:, None], direction) > 0)
    incoming = torch.where(above, incoming / (count * pdf.clamp_min(1e-9)), torch.zeros_like(incoming))
    factors = torch.cat([cosine / math.pi, specular_brdf_cosine(n, o, direction, r)], -1)
    return direction, incoming, factors


class DirectLight:
    """Estimates direct light; compiled where ``compiled`` is true (seconds once, then several times faster)."""

    def __init__(self, *, compiled: bool) -> None:
        self._draw: Callable[..., tuple[Tensor, Tensor, Tensor]] = (
            torch.compile(draw_samples, dynamic=False) if compiled else draw_samples
        )

    def __call__(
        self,
        rays: RayCaster,
        tables: LightTables,
        light: Tensor,
        position: Tensor,
        normal: Tensor,
        view: Tensor,
        geometric: Tensor,
        roughness: Tensor,
        u: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Direct light at N points by K directions each: irradiance / pi and specular radiance, both (N, 3)."""
        size = CHUNK_SAMPLES // u.shape[1]
        diffuse, specular = [], []
        for start in range(0, len(position), size):
            part = slice(start, start + size)
            chunk = [pad(x[part], size) for x in (normal, view, geometric, roughness, light, u)]
            direction, incoming, factors = self._draw(
                *chunk,
                tables.height,
                tables.width,
                tables.radiance,
                tables.density,
                tables.direction,
                tables.cosine,
                tables.emission,
                tables.disc_density,
                tables.cumulative,
            )
            filled = len(position[part])
            lit = incoming[:filled, :, 1] > 0
            point, sample = torch.nonzero(lit, as_tuple=True)
            origin = position[part] + OFFSET * geometric[part]
            blocked = rays.occluded(origin[point], direction[point, sample])
            lit[point[blocked], sample[blocked]] = False
            total = torch.bmm((incoming[:filled] * lit[..., None]).transpose(1, 2), factors[:filled])
            diffuse.append(total[..., 0])
            specular.append(total[..., 1])
        if not diffuse:
            return torch.zeros(0, 3), torch.zeros(0, 3)
        return torch.cat(diffuse), torch.cat(specular)


def pad(values: Tensor, size: int) -> Tensor:
    """Repeat the first row at the end until there are ``size``, so that compiled code sees one shape."""
    missing = size - len(values)
    return values if missing == 0 else torch.cat([values, values[:1].expand(missing, *values.shape[1:])])


def cosine_directions(normal: Tensor, u: Tensor) -> Tensor:
    """Directions of density cosine / pi about (N, 3) normals from (N, K, 2) uniforms: (N, K, 3)."""
    tangent, bitangent = tangent_frame(normal)
    radius, angle = u[..., 0:1].sqrt(), 2 * math.pi * u[..., 1:2]
    up = (1 - u[..., 0:1]).clamp_min(1e-6).sqrt()
    return radius * (torch.cos(angle) * tangent[:, None] + torch.sin(angle) * bitangent[:, None]) + up * normal[:, None]
