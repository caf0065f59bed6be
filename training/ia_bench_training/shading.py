"""Direct light at many points under many small lights at once: multiple importance sampling, shadows by Embree.

The estimator is that of :mod:`ia_bench.render.estimator` with a third technique: directions follow the light, the visible
GGX normals, or the cosine. Cosine rays are traced for the bounce anyway, and they are what smooth light needs. The light
is sampled from one luminance table per image, not from tables by surface normal: an image has a light of its own here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.light.latlong import direction_to_texel, row_solid_angles, texel_to_direction
from ia_bench.material.brdf import dot, sample_visible_ggx, specular_brdf_cosine, tangent_frame, visible_ggx_pdf
from ia_bench.render.rays import RayCaster
from ia_bench_training.lights import HEIGHT, MAX_DISCS, WIDTH, Light

CHUNK_SAMPLES = 32_768  # directions shaded at a time: few enough for the cache, one shape for the compiler
OFFSET = 2e-4  # of secondary rays off the surface; objects have radius 1
TEXELS, STRATA = HEIGHT * WIDTH, MAX_DISCS + HEIGHT


@dataclass(frozen=True)
class LightTables:
    """L lights stacked for sampling. A light's strata are its discs, then the rows of its map.

    One cumulative distribution per light, or per row, is concatenated with the others; number k is shifted by k, so that a
    single search finds the entry within it.

    Attributes:
        strata: (L STRATA,) float64, one cumulative distribution per light over its strata.
        stratum_chance: (L STRATA,), the probability of each stratum.
        columns: (L H W,) float64, one cumulative distribution per row of every map.
        column_chance: (L H W,), the probability of each texel within its row.
        radiance: (L H W, 3), of the maps.
        density: (L H W,), with which the texels of the maps are drawn, per steradian.
        direction: (L, D, 3), of the discs.
        cosine: (L, D), of the discs' angular radius.
        emission: (L, D, 3), of the discs.
        disc_density: (L, D), with which the discs are drawn, per steradian.
    """

    strata: Tensor
    stratum_chance: Tensor
    columns: Tensor
    column_chance: Tensor
    radiance: Tensor
    density: Tensor
    direction: Tensor
    cosine: Tensor
    emission: Tensor
    disc_density: Tensor

    @classmethod
    def build(cls, lights: Sequence[Light]) -> LightTables:
        """Chances in proportion to mean radiance times solid angle, of texels and discs alike."""
        count = len(lights)
        radiance = torch.stack([light.radiance for light in lights])
        cosine = torch.stack([light.cosine for light in lights])
        emission = torch.stack([light.emission for light in lights])
        area = row_solid_angles(HEIGHT, WIDTH)[:, None]
        disc_area = 2 * math.pi * (1 - cosine.double()).clamp_min(0)
        power = radiance.double().mean(-1) * area
        disc_power = emission.double().mean(-1) * disc_area
        total = power.sum((1, 2)) + disc_power.sum(1)
        chance = torch.cat([disc_power, power.sum(2)], 1) / total[:, None]
        column_chance = power / power.sum(2, keepdim=True)
        rows = torch.arange(count * HEIGHT).reshape(count, HEIGHT, 1)
        return cls(
            strata=(_cumulative(chance) + torch.arange(count)[:, None]).reshape(-1),
            stratum_chance=chance.reshape(-1),
            columns=(_cumulative(column_chance) + rows).reshape(-1),
            column_chance=column_chance.reshape(-1),
            radiance=radiance.reshape(-1, 3),
            density=(power / (area * total[:, None, None])).float().reshape(-1),
            direction=torch.stack([light.direction for light in lights]),
            cosine=cosine,
            emission=emission,
            disc_density=(disc_power / (total[:, None] * disc_area.clamp_min(1e-12))).float(),
        )


def _cumulative(chance: Tensor) -> Tensor:
    total = chance.cumsum(-1)
    return total / total[..., -1:]


def _invert(cumulative: Tensor, chance: Tensor, table: Tensor, u: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Look up uniform ``u`` (float64): the entry within its table, and the place inside that entry in [0, 1)."""
    target = table + u
    found = torch.searchsorted(cumulative, target, right=True)
    entry = (found - table * size).clamp(0, size - 1)
    index = table * size + entry
    inside = 1 - (cumulative[index] - target) / chance[index].clamp_min(1e-30)
    return entry, inside.clamp(0, 1).float()


def sample_lights(light: Tensor, u: Tensor, tables: LightTables) -> Tensor:
    """Directions (N, K, 3) that follow lights (N,), from ``u`` (N, K, 2) uniform, float64."""
    stratum, across = _invert(tables.strata, tables.stratum_chance, light[:, None].expand(u.shape[:2]), u[..., 0], STRATA)
    row = (stratum - MAX_DISCS).clamp_min(0)
    column, along = _invert(tables.columns, tables.column_chance, light[:, None] * HEIGHT + row, u[..., 1], WIDTH)
    to_texel = texel_to_direction(row * WIDTH + column, across, along, HEIGHT, WIDTH)
    which = light[:, None] * MAX_DISCS + stratum.clamp(max=MAX_DISCS - 1)
    axis, edge = tables.direction.reshape(-1, 3)[which], tables.cosine.reshape(-1)[which][..., None]
    cos_disc = 1 - across[..., None] * (1 - edge)
    to_disc = _around(axis, cos_disc, u[..., 1:].float())
    return torch.where((stratum < MAX_DISCS)[..., None], to_disc, to_texel)


def _around(axis: Tensor, cosine: Tensor, turn: Tensor) -> Tensor:
    """Unit directions at a given cosine from ``axis``; ``turn`` in [0, 1) goes round once."""
    tangent, bitangent = tangent_frame(axis)
    angle = 2 * math.pi * turn
    sine = torch.sqrt((1 - cosine * cosine).clamp_min(0))
    return sine * (torch.cos(angle) * tangent + torch.sin(angle) * bitangent) + cosine * axis


def cosine_directions(normal: Tensor, u: Tensor) -> Tensor:
    """Directions of density cosine / pi about (N, 3) normals, from (N, K, 2) uniforms: (N, K, 3)."""
    return _around(normal[:, None], (1 - u[..., :1]).clamp_min(1e-6).sqrt(), u[..., 1:2])


def draw_samples(
    normal: Tensor, view: Tensor, geometric: Tensor, roughness: Tensor, light: Tensor, cosine_rays: Tensor, u_light: Tensor,
    u_brdf: Tensor, tables: LightTables,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """Directions for N points, by cosine, light and BRDF in this order, and what each adds if nothing is in its way.

    The arguments are ``normal``, ``view`` and ``geometric`` (N, 3), ``roughness`` (N, 1), ``light`` (N,), ``cosine_rays``
    (N, A, 3), ``u_light`` (N, B, 2) float64 and ``u_brdf`` (N, C, 2), where C = 0 leaves the specular part out.

    Returns:
        Directions (N, A + B + C, 3).
        Radiance times the weight of the balance heuristic, of the same shape; zero below the surface.
        The cosine over pi, and the specular BRDF times the cosine, (N, A + B + C, 2).
    """
    n, o, r = normal[:, None], view[:, None], roughness[:, None]
    to_light = sample_lights(light, u_light, tables)
    specular = u_brdf.shape[1] > 0
    reflected = [sample_visible_ggx(n, o, r, u_brdf)] if specular else []
    direction = torch.cat([cosine_rays, to_light, *reflected], 1)

    texel = light[:, None] * TEXELS + direction_to_texel(direction, HEIGHT, WIDTH)
    incoming, light_pdf = tables.radiance[texel], tables.density[texel][..., None]
    for disc in range(MAX_DISCS):
        inside = dot(direction, tables.direction[light, disc][:, None]) > tables.cosine[light, disc][:, None, None]
        incoming = incoming + inside * tables.emission[light, disc][:, None]
        light_pdf = light_pdf + inside * tables.disc_density[light, disc][:, None, None]
    cosine = dot(n, direction)
    pdf = cosine_rays.shape[1] / math.pi * cosine.clamp_min(0) + u_light.shape[1] * light_pdf
    if specular:
        pdf = pdf + u_brdf.shape[1] * visible_ggx_pdf(n, o, direction, r)
        reflectance = specular_brdf_cosine(n, o, direction, r)
    else:
        reflectance = torch.zeros_like(cosine)
    above = (cosine > 0) & (dot(geometric[:, None], direction) > 0)
    incoming = torch.where(above, incoming / pdf.clamp_min(1e-9), torch.zeros_like(incoming))
    return direction, incoming, torch.cat([cosine / math.pi, reflectance], -1)


class DirectLight:
    """An estimator of direct light. Compiling it (``compiled``) takes seconds once and makes it faster."""

    def __init__(self, *, compiled: bool) -> None:
        draw: Callable[..., tuple[Tensor, Tensor, Tensor]] = draw_samples
        self._draw = torch.compile(draw, dynamic=False) if compiled else draw

    def __call__(
        self, rays: RayCaster, tables: LightTables, light: Tensor, position: Tensor, normal: Tensor, view: Tensor,
        geometric: Tensor, roughness: Tensor, cosine_rays: Tensor, reaches_sky: Tensor | None, u_light: Tensor, u_brdf: Tensor,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        """Direct light at N points: irradiance / pi and specular radiance, both (N, 3).

        ``reaches_sky`` (N, A) bool says which cosine rays are known to escape; with None they are traced.
        """
        size = CHUNK_SAMPLES // (cosine_rays.shape[1] + u_light.shape[1] + u_brdf.shape[1])
        known = 0 if reaches_sky is None else cosine_rays.shape[1]
        parts = [torch.zeros(0, 3, 2)]
        for start in range(0, len(position), size):
            part = slice(start, start + size)
            chunk = [pad(x[part], size) for x in (normal, view, geometric, roughness, light, cosine_rays, u_light, u_brdf)]
            found = self._draw(*chunk, tables)
            direction, incoming, factors = (x[: len(position[part])] for x in found)
            lit = incoming[..., 1] > 0
            point, sample = torch.nonzero(lit[:, known:], as_tuple=True)
            origin = position[part] + OFFSET * geometric[part]
            blocked = rays.occluded(origin[point], direction[point, sample + known])
            lit[point[blocked], sample[blocked] + known] = False
            if reaches_sky is not None:
                lit[:, :known] &= reaches_sky[part]
            parts.append(torch.bmm((incoming * lit[..., None]).transpose(1, 2), factors))
        total = torch.cat(parts)
        return total[..., 0], total[..., 1]


def pad(values: Tensor, size: int) -> Tensor:
    """Repeat the first row at the end until there are ``size``, so that compiled code sees one shape."""
    missing = size - len(values)
    return values if missing == 0 else torch.cat([values, values[:1].expand(missing, *values.shape[1:])])
