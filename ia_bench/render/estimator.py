"""The estimator of :mod:`ia_bench.render.kernels` over torch tensors, differentiable in textures and light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ia_bench.common.native import LANES
from ia_bench.common.warp_launch import launch
from ia_bench.light.latlong import LatLongSampler
from ia_bench.light.warp_latlong import tables_of
from ia_bench.material.brdf import GOLDEN, PLASTIC, coat_reflectance
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.kernels import shade_adjoint
from ia_bench.render.warp_draw import draw
from ia_bench.render.warp_shade import shade


@dataclass(frozen=True)
class DirectionSamples:
    """Directions of N points, ``count`` by the light and then ``count`` by the BRDF."""

    direction: Tensor  # (N, 2 count, 3), unit
    texel: Tensor  # (N, 2 count) int32, of the light; -1 where a sample adds nothing, below: warp_control.subtract
    terms: Tensor  # (N, 2 count, 4), what the sample is worth; see :func:`ia_bench.render.warp_draw.draw`
    boost: Tensor  # (N, count), by how much more the directions by the BRDF would weigh if there were no others


class FromObject(NamedTuple):
    """What the object throws onto itself, in the eyes of N points."""

    arriving: Tensor  # (A, 3), the irradiance of the texels of an atlas; differentiable. Of K lights one after another, (K A, 3)
    leaving: Tensor  # (A, 3), their radiance; differentiable. Likewise
    atlas: Tensor  # (side, side) int32, the texel at each place
    seen: Tensor  # (N, count) int32, the row of ``leaving`` that each direction by the BRDF ends on, -1 for none
    first: Tensor | None = None  # (N,) int32, the row of ``arriving`` that is a point's texel 0; None for row 0


@dataclass(frozen=True)
class PixelRadiance:
    """What P pixels, or points of a surface, send to the camera, each (P, 3); of pixels premultiplied."""

    diffuse: Tensor  # radiance of the diffuse lobe, indirect light included
    specular: Tensor  # radiance of the specular lobe under the light itself: the paper's specular shading
    albedo: Tensor  # the texture, no radiance
    mirrored: Tensor | None = None  # specular radiance of the object in itself, None without indirect light

    @property
    def radiance(self) -> Tensor:
        """Everything that reaches the camera, (P, 3)."""
        shaded = self.diffuse + self.specular
        return shaded if self.mirrored is None else shaded + self.mirrored

    def exposed(self, factors: Tensor) -> PixelRadiance:
        """The same light times (P, 1) or (P, 3) factors; the albedo stays."""
        return replace(self.each(lambda values: factors * values), albedo=self.albedo)

    def averaged(self, estimates: int) -> PixelRadiance:
        """The mean of several estimates of the same pixels, one after another: (estimates P, 3) to (P, 3)."""
        return self.each(lambda values: values.unflatten(0, (estimates, -1)).mean(0))

    def each(self, change: Callable[[Tensor], Tensor]) -> PixelRadiance:
        """All of them after a ``change``."""
        changed: dict[str, Any] = {name: None if values is None else change(values) for name, values in vars(self).items()}
        return PixelRadiance(**changed)


@torch.no_grad()
def draw_samples(
    surface: SurfacePoints,
    hit: Tensor,
    roughness: Tensor,
    sampler: LatLongSampler,
    rotation: Tensor,
    *,
    points: int,
    count: int,
    part: int = 0,
    parts: int = 1,
) -> DirectionSamples:
    """Draw for N = P ``points`` surface points of P pixels; what occludes the light is not known here yet.

    Args:
        surface: The points, those of a pixel one after another.
        hit: (N,) bool, whether there is a point.
        roughness: Texture (T, T, 1).
        sampler: The light's tables.
        rotation: (2, P, 3) float64 in [0, 1), the Cranley-Patterson rotations of each pixel's lattices, by light and by BRDF.
        points: How many of them a pixel has.
        count: Directions of each technique.
        part: Which pass this is, where a lattice is dealt out to several.
        parts: How many passes there are.
    """
    n, device = len(surface.position), surface.position.device
    lanes = LANES if device.type == "cpu" else 1
    direction = torch.empty(n, 2 * count, 3, device=device)
    texel = torch.empty(n, 2 * count, dtype=torch.int32, device=device)
    terms, boost = torch.empty(n, 2 * count, 4, device=device), torch.empty(n, count, device=device)
    launch(
        draw, n, lanes, hit.view(torch.uint8), surface.normal, surface.view, surface.uv,
        _flat(roughness, 1), len(roughness), rotation, tables_of(sampler), points, count, part, parts,
        torch.empty(n, device=device), direction, texel, terms, boost, device=device, lanes=lanes,
    )  # fmt: skip
    return DirectionSamples(direction, texel, terms, boost)


def shade_samples(
    surface: SurfacePoints,
    samples: DirectionSamples,
    material: Material,
    radiance: Tensor,
    coat: str,
    of_object: FromObject | None,
    steady: Tensor | None = None,
) -> PixelRadiance:
    """Sum the samples under a light of ``radiance`` (H, W, 3). Differentiable in it, in the textures, ``of_object`` and ``steady``.

    ``steady`` (N, 3): irradiance that no sample estimates (:mod:`ia_bench.render.control`).
    ``coat``: "layered" or "added"; see :class:`ia_bench.render.settings.RenderSettings`.
    """
    textures = material.albedo, material.roughness, material.metallic
    arriving, leaving, atlas, seen, first = of_object or (None, None, None, None, None)
    tables = atlas, coat_reflectance().to(radiance.device) if coat == "layered" else None
    fixed = (
        *(0 if texture is None else len(texture) for texture in textures),  # a side of 0 stands for none
        surface.normal, surface.view, surface.uv, surface.front[:, 0].float(),
        samples.texel, samples.terms, samples.boost, seen, first, samples.boost.shape[1],
        *(part for table in tables for part in ((None, 0) if table is None else (table.reshape(-1), len(table)))),
    )  # fmt: skip
    albedo, roughness = _flat(material.albedo, 3), _flat(material.roughness, 1)
    metallic = None if material.metallic is None else _flat(material.metallic, 1)
    leaves = radiance.reshape(-1, 3).contiguous(), albedo, roughness, metallic, arriving, leaving, steady
    diffuse, specular, mirrored, colour = _Shade.apply(fixed, *leaves)
    return PixelRadiance(diffuse, specular, colour, None if of_object is None else mirrored)


def _flat(texture: Tensor, channels: int) -> Tensor:
    """A square texture as the kernels take it, which would read beyond the end of any other."""
    if texture.shape != (len(texture), len(texture), channels):
        raise ValueError(f"texture: expected the shape (T, T, {channels}), found {tuple(texture.shape)}")
    return texture.reshape((-1, channels) if channels > 1 else -1).contiguous()


class _Shade(torch.autograd.Function):
    """:func:`ia_bench.render.warp_shade.shade` and its adjoint."""

    @staticmethod
    def forward(ctx: Any, fixed: tuple[Any, ...], *leaves: Tensor | None) -> tuple[Tensor, ...]:  # noqa: ANN401 (torch's context)
        normals = fixed[3]
        results = tuple(torch.empty_like(normals) for _ in range(4))
        lanes = LANES if normals.device.type == "cpu" else 1
        launch(shade, len(normals), *leaves, *fixed, *results, device=normals.device, lanes=lanes)
        ctx.save_for_backward(*leaves)
        ctx.fixed = fixed
        return results

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401 (torch's context)
        leaves, given = ctx.saved_tensors, [gradient.contiguous() for gradient in gradients]
        adjoints = [None if leaf is None else torch.zeros_like(leaf) for leaf in leaves]
        launch(shade_adjoint, len(given[0]), *leaves, *ctx.fixed, *given, sums=adjoints, device=given[0].device)
        return None, *adjoints


def lattice(rotation: Tensor, points: int, count: int, part: int = 0, parts: int = 1) -> Tensor:
    """Lattice samples of (P, 3) rotations in [0, 1), one a pixel: (P, points, count, 3), uniform in [0, 1)^3, float64.

    Point s of a pixel takes the lattice's entries s, s + points, s + 2 points, ..., so that each spans the whole range. A
    lattice too long for one pass is dealt out to ``parts`` of them: of each point's entries the first pass takes the first, the
    second the second, and so on in turn; ``part`` says which pass this is.
    """
    entry = part + parts * torch.arange(count, dtype=torch.float64, device=rotation.device)
    index = (points * entry[:, None] + torch.arange(points, device=rotation.device)).reshape(-1)
    generators = torch.stack([index / (parts * points * count), index * GOLDEN, index * PLASTIC], -1)
    samples = torch.remainder(rotation[:, None] + generators, 1.0).clamp(max=1 - 2**-24)
    return samples.reshape(len(rotation), count, points, 3).transpose(1, 2)
