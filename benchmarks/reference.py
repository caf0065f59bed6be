"""The renderer's estimator in plain torch: slow, of any precision, and differentiable as often as wanted.

Tests and benchmarks compare the kernels of :mod:`ia_bench.render.kernels` with it, and what needs second derivatives renders
with it. What it shares with them are the sampler's tables, the lattice, the table of the coat and the rays; the formulas of
the BRDF are those of :mod:`ia_bench.material.brdf`, and every gradient is autograd's. Results have the precision of the
vectors that go in; u, where it is uniform in [0, 1), is always float64.

Shapes: N points, K = 2 ``count`` directions of each, the first half by the light and the second by the BRDF.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.light.latlong import BIN_SIDE, LatLongSampler, SampledLight, direction_to_texel, texel_to_direction
from ia_bench.material.brdf import (
    F0,
    MIN_COSINE,
    coat_reflectance,
    dot,
    microfacets,
    normalize,
    sample_visible_ggx,
    visible_ggx_pdf,
)
from ia_bench.material.textures import Material
from ia_bench.render import indirect as interreflections
from ia_bench.render.estimator import FromObject, PixelRadiance, lattice
from ia_bench.render.gbuffer import GBuffer, SurfacePoints
from ia_bench.render.indirect import IndirectLight, Interreflection
from ia_bench.render.renderer import Renderer, samples_taken
from ia_bench.scenes.scene import Mesh

LEAST_PDF = 1e-12


# ---------------------------------------------------------------- textures and surfaces
def bilinear_taps(uv: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The four texels around each UV (..., 2): their indices (..., 4) in the flattened texture, and their weights (..., 4).

    Beyond the border the nearest texel is repeated.
    """
    column = uv[..., 0] * width - 0.5
    row = (1 - uv[..., 1]) * height - 0.5
    left, top = torch.floor(column), torch.floor(row)
    right_weight, bottom_weight = column - left, row - top
    left, top = left.long(), top.long()
    columns = torch.stack([left, left + 1], -1).clamp(0, width - 1)
    rows = torch.stack([top, top + 1], -1).clamp(0, height - 1)
    index = (rows[..., :, None] * width + columns[..., None, :]).flatten(-2)
    across = torch.stack([1 - right_weight, right_weight], -1)
    down = torch.stack([1 - bottom_weight, bottom_weight], -1)
    return index, (down[..., :, None] * across[..., None, :]).flatten(-2)


def fetch(texture: Tensor, uv: Tensor) -> Tensor:
    """Look up a texture (H, W, C) bilinearly at UV (..., 2): (..., C). See :func:`ia_bench.material.textures.fetch`."""
    height, width, channels = texture.shape
    index, weight = bilinear_taps(uv, height, width)
    return (texture.reshape(-1, channels)[index] * weight[..., None]).sum(-2)


def specular_lobes(normal: Tensor, view: Tensor, incident: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """Two parts of the specular BRDF times (n.i), which is the reflectance at normal incidence times the first plus the second.

    (Schlick's approximation is linear in that reflectance.) Arguments as of :func:`ia_bench.material.brdf.specular_brdf_cosine`.
    """
    value, cosine = microfacets(normal, view, incident, roughness)
    grazing = value * (1 - cosine) ** 5
    return value - grazing, grazing


def normal_reflectance(albedo: Tensor, metallic: Tensor) -> Tensor:
    """Reflectance at normal incidence (N, 3) of albedo (N, 3) and metallic (N, 1)."""
    return F0 + metallic * (albedo - F0)


def passed_by_coat(roughness: Tensor, cosine: Tensor) -> Tensor:
    """The share of light that the coat leaves to the diffuse lobe, (N, 1), by roughness (N, 1) and cosine to the viewer (N, 1).

    It is one minus the directional albedo toward the viewer, as the Principled BSDF of Blender has it (Burley 2015 without
    its diffuse retro-reflection). Differentiable in the roughness.
    """
    table = coat_reflectance().to(roughness)
    size = len(table)
    column, row = ((place * (size - 1) + 0.5) / size for place in (cosine, roughness))  # entries are texel centres
    index, weight = bilinear_taps(torch.cat([column, 1 - row], -1), size, size)
    return 1 - (table.reshape(-1)[index] * weight).sum(-1, keepdim=True)


def fetch_atlas(values: Tensor, row: Tensor, uv: Tensor) -> Tensor:
    """The same of (A, C) values of the texels of an atlas; ``row`` (side, side) says which of them lies where."""
    index, weight = bilinear_taps(uv, *row.shape)
    return (values[row.reshape(-1)[index]] * weight[..., None]).sum(-2)


def interpolate(mesh: Mesh, face: Tensor, barycentric: Tensor, camera: Tensor) -> tuple[SurfacePoints, Tensor]:
    """Points of (N,) faces, (N, 2) barycentrics, seen from (N, 3), and which normals were bent, (N,) bool.

    See :class:`ia_bench.render.gbuffer.SurfaceInterpolator`.
    """
    corners = torch.from_numpy(mesh.faces).long()[face.clamp_min(0)]
    weights = torch.cat([1 - barycentric.sum(-1, keepdim=True), barycentric], -1)[..., None]
    vertices, normals, uvs = (torch.from_numpy(a).to(barycentric)[corners] for a in (mesh.vertices, mesh.normals, mesh.uv))
    position, normal, uv = ((values * weights).sum(1) for values in (vertices, normals, uvs))
    geometric = normalize(torch.linalg.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]))
    view = normalize(camera - position)
    front = dot(geometric, view) >= 0
    side = torch.where(front, 1.0, -1.0).to(view)
    normal, geometric = normalize(normal) * side, geometric * side
    cosine = dot(normal, view)
    bent = cosine < MIN_COSINE
    normal = torch.where(bent, normalize(normal + (10 * MIN_COSINE - cosine) * view), normal)
    return SurfacePoints(position, normal, view, uv, geometric, front), bent[:, 0] & (face >= 0)


# ---------------------------------------------------------------- the light's sampler
def normal_bin(normal: Tensor) -> Tensor:
    """The octahedral cell (...,) int64 in [0, BIN_SIDE^2) that each unit normal (..., 3) falls into."""
    x, y, z = (normal / normal.abs().sum(-1, keepdim=True)).unbind(-1)
    folded_x = torch.where(z >= 0, x, (1 - y.abs()) * torch.where(x >= 0, 1.0, -1.0))
    folded_y = torch.where(z >= 0, y, (1 - x.abs()) * torch.where(y >= 0, 1.0, -1.0))
    column, row = (((0.5 + 0.5 * c) * BIN_SIDE).long().clamp(0, BIN_SIDE - 1) for c in (folded_x, folded_y))
    return row * BIN_SIDE + column


def sample_texel(sampler: LatLongSampler, cell: Tensor, u: Tensor) -> Tensor:
    """Texels drawn by ``u`` (..., N) for the normals' cells (..., 1)."""
    last = len(sampler.edges) - 2
    target = cell + u
    place = torch.searchsorted(sampler.entries, target.contiguous(), right=True) - 1
    entry = (place - cell * (last + 1)).clamp(0, last)
    place = cell * (last + 1) + entry
    lower, upper = sampler.entries[place], sampler.entries[place + 1]
    rest = ((target - lower) / (upper - lower)).clamp(0, 1 - 2**-40)  # uniform again, inside the entry
    lower, upper = sampler.edges[entry], sampler.edges[entry + 1]
    found = torch.searchsorted(sampler.texels, lower + rest * (upper - lower), right=True)
    first = torch.where(entry <= last // 2, 0, len(sampler.grid.order))
    return sampler.grid.order[(found - first).clamp(0, len(sampler.grid.order) - 1)]


def density(sampler: LatLongSampler, cell: Tensor, texel: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """Density per steradian with which ``texel`` (...,) is drawn for the normals of ``cell``, which broadcasts."""
    bound = sampler.grid.bound.reshape(-1)[cell * sampler.grid.bound.shape[1] + sampler.grid.block[texel]]
    share, evenly = sampler.share[cell].to(dtype), sampler.evenly[cell].to(dtype)
    return bound.to(dtype) * (sampler.brightness[texel].to(dtype) * share + evenly)


# ---------------------------------------------------------------- the estimator
def draw_directions(
    normal: Tensor, view: Tensor, roughness: Tensor, by_light: Tensor, by_brdf: Tensor, sampler: LatLongSampler
) -> tuple[Tensor, Tensor]:
    """Directions (N, K, 3) and the light's texels (N, K) that they end in.

    ``normal``, ``view`` (N, 3); ``roughness`` (N, 1); ``by_light``, ``by_brdf`` (N, count, 3), uniform.
    """
    height, width, dtype = sampler.height, sampler.width, normal.dtype
    texel = sample_texel(sampler, normal_bin(normal)[:, None], by_light[..., 0])
    inside = by_light[..., 1:].to(dtype)
    to_light = texel_to_direction(texel.to(dtype), inside[..., 0], inside[..., 1], height, width)
    reflected = sample_visible_ggx(normal[:, None], view[:, None], roughness[:, None], by_brdf[..., :2].to(dtype))
    direction = torch.cat([to_light, reflected], 1)
    return direction, torch.cat([texel, direction_to_texel(reflected, height, width)], 1)


def weigh_directions(
    normal: Tensor, view: Tensor, roughness: Tensor, direction: Tensor, texel: Tensor, sampler: LatLongSampler
) -> Tensor:
    """The balance heuristic's 1 / (count p_light + count p_brdf), (N, K, 1); zero below the horizon."""
    n, o, r = normal[:, None], view[:, None], roughness[:, None]
    by_light = density(sampler, normal_bin(normal)[:, None], texel, normal.dtype)[..., None]
    pdf = by_light + visible_ggx_pdf(n, o, direction, r)
    weight = 1 / (direction.shape[1] // 2 * pdf.clamp_min(LEAST_PDF))
    return torch.where(dot(n, direction) > 0, weight, torch.zeros_like(weight))


def sample_directions(
    normal: Tensor, view: Tensor, roughness: Tensor, by_light: Tensor, by_brdf: Tensor, sampler: LatLongSampler
) -> tuple[Tensor, Tensor, Tensor]:
    """Directions, texels and weights of both functions above; what the mesh occludes is not known here yet."""
    direction, texel = draw_directions(normal, view, roughness, by_light, by_brdf, sampler)
    return direction, texel, weigh_directions(normal, view, roughness, direction, texel, sampler)


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
    point_albedo, point_roughness = fetch(albedo, uv), fetch(roughness, uv)[:, None]
    incoming = radiance[texel] * weight
    cosine = dot(normal[:, None], direction).clamp_min(0)
    diffuse = point_albedo * (incoming * cosine).sum(1) / math.pi
    base, grazing = specular_lobes(normal[:, None], view[:, None], direction, point_roughness)
    if metallic is None:
        return diffuse, (incoming * (F0 * base + grazing)).sum(1), point_albedo
    point_metallic = fetch(metallic, uv)
    specular = normal_reflectance(point_albedo, point_metallic) * (incoming * base).sum(1) + (incoming * grazing).sum(1)
    return diffuse * (1 - point_metallic), specular, point_albedo


def mirrored(surface: SurfacePoints, direction: Tensor, material: Material, leaving: Tensor, seen: Tensor) -> Tensor:
    """Specular radiance (N, 3) that the object sends along the directions by the BRDF, (N, count, 3).

    Args:
        surface: The points.
        direction: Drawn from the visible GGX normals alone.
        material: Differentiable.
        leaving: (A, 3), radiance of the texels of the atlas; differentiable.
        seen: (N, count), the texel that each direction ends on, -1 for none.
    """
    normal, view = surface.normal[:, None], surface.view[:, None]
    roughness = fetch(material.roughness, surface.uv)[:, None]
    pdf = visible_ggx_pdf(normal, view, direction, roughness.detach())
    base, grazing = specular_lobes(normal, view, direction, roughness)
    at_normal: Tensor | float = F0
    if material.metallic is not None:
        at_normal = normal_reflectance(fetch(material.albedo, surface.uv), fetch(material.metallic, surface.uv))[:, None]
    sent = leaving[seen.clamp_min(0)] * (seen >= 0)[..., None] / (direction.shape[1] * pdf.clamp_min(LEAST_PDF))
    return (sent * (at_normal * base + grazing)).sum(1)


def shade(
    surface: SurfacePoints,
    direction: Tensor,
    texel: Tensor,
    weight: Tensor,
    material: Material,
    radiance: Tensor,
    coat: str,
    of_object: FromObject | None,
    shade_directions: Callable[..., tuple[Tensor, Tensor, Tensor]] = shade_directions,
) -> PixelRadiance:
    """As :func:`ia_bench.render.estimator.shade_samples`, of directions (N, K, 3), texels (N, K) and weights (N, K, 1)."""
    diffuse, specular, albedo = shade_directions(
        surface.normal, surface.view, surface.uv, direction, texel, weight, material.albedo, material.roughness,
        radiance.reshape(-1, 3), material.metallic,
    )  # fmt: skip
    from_object = None
    if of_object is not None:
        reflected = albedo if material.metallic is None else albedo * (1 - fetch(material.metallic, surface.uv))
        arriving = fetch_atlas(of_object.arriving, of_object.atlas, surface.uv) * surface.front
        diffuse = diffuse + reflected * arriving / math.pi
        by_brdf = direction[:, direction.shape[1] // 2 :]
        from_object = mirrored(surface, by_brdf, material, of_object.leaving, of_object.seen)
    if coat == "layered":
        diffuse = diffuse * passed_by_coat(fetch(material.roughness, surface.uv), dot(surface.normal, surface.view))
    return PixelRadiance(diffuse, specular, albedo, from_object)


# ---------------------------------------------------------------- the renderer
def solve(bounced: Interreflection, albedo: Tensor, radiance: Tensor) -> IndirectLight:
    """As :meth:`ia_bench.render.indirect.Interreflection.solve`."""
    direct = bounced.sky.apply(interreflections._cells(radiance))
    reflectance = fetch(albedo, bounced.uv) / math.pi
    indirect = torch.zeros_like(direct)
    for _ in range(bounced.bounces):
        indirect = bounced.exchange.apply(reflectance * (direct + indirect))
    return IndirectLight(bounced, indirect, reflectance * (direct + indirect))


def can_compile() -> bool:
    """Whether torch.compile finds a C++ compiler."""
    return any(shutil.which(name) for name in ("g++", "clang++"))


class TorchRenderer(Renderer):
    """What another renderer renders, by torch: with the same generator the same numbers up to rounding.

    ``compiled`` by torch.compile, which takes seconds once and gives first derivatives only.
    """

    def __init__(self, renderer: Renderer, *, compiled: bool = False) -> None:
        super().__init__(renderer.surface, renderer.rays, interreflection=renderer.interreflection, coat=renderer.coat)
        if self.interreflection is not None and self.interreflection.control is not None:
            raise ValueError("expected a renderer without a control variate, which torch has no counterpart of here")
        self._sample, self._shade = sample_directions, shade_directions
        if compiled:
            self._sample, self._shade = (torch.compile(f, dynamic=False) for f in (sample_directions, shade_directions))

    def _bounce(self, gbuffer: GBuffer, material: Material, light: SampledLight, most: int | None = None) -> IndirectLight | None:
        own = self.interreflection
        return None if own is None else solve(own, material.albedo, light.radiance)

    def _render(
        self,
        gbuffer: GBuffer,
        pixels: Tensor,
        material: Material,
        light: SampledLight,
        indirect: IndirectLight | None,
        samples: int,
        rotation: Tensor,
        part: int = 0,
        parts: int = 1,
    ) -> PixelRadiance:
        """As the kernels do, but for its ``ray_cache``: every ray is traced again."""
        points = gbuffer.subsamples
        count = samples_taken(samples, points) // (2 * points)
        with torch.no_grad():
            face = gbuffer.face[pixels].masked_fill(pixels[:, None] < 0, -1).reshape(-1)
            camera = gbuffer.seen_from(pixels).repeat_interleave(points, 0)
            surface = self.surface(face, gbuffer.barycentric[pixels].reshape(-1, 2), camera)
            by_light, by_brdf = (lattice(start, points, count, part, parts).reshape(-1, count, 3) for start in rotation)
            roughness = fetch(material.roughness.detach(), surface.uv)
            direction, texel, weight = self._sample(surface.normal, surface.view, roughness, by_light, by_brdf, light.sampler)
            blocked = self.blocked(surface, direction, (weight[..., 0] > 0) & (face >= 0)[:, None])
            of_object = None
            if indirect is not None:
                of_object = indirect.seen_by(None, indirect.baked.seen(surface, direction[:, count:], blocked[:, count:]))
        weight = weight * ~blocked[..., None]
        shaded = shade(surface, direction, texel, weight, material, light.radiance, self.coat, of_object, self._shade)
        pool = (face >= 0).reshape(-1, points, 1) / points
        return shaded.each(lambda values: (values.reshape(-1, points, 3) * pool).sum(1))
