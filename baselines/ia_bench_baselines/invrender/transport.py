"""Which other parts of the object surface points see in fixed directions, traced once."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.cache import Cache
from ia_bench.render.indirect import Atlas, mesh_key
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, fibonacci_axes

TEXELS_AT_ONCE = 1024


@dataclass(frozen=True)
class Transport:
    """N texels of an atlas as points on the surface, and what lies in K directions from each.

    Attributes:
        atlas: The texels.
        directions: (K, 3), spread evenly over the sphere.
        position: (N, 3) of the texels, in scene units.
        normal: (N, 3), shading normals on the side from which triangles are wound counter-clockwise.
        above: (N, K) bool, whether a direction is above the texel's triangle.
        landed: (N, K) int32, the texel that is in its way; -1 for none, and for the back of a triangle, which sends nothing.
    """

    atlas: Atlas
    directions: Tensor
    position: Tensor
    normal: Tensor
    above: Tensor
    landed: Tensor

    @classmethod
    def of(cls, stage: Stage, size: int, count: int) -> Transport:
        """Of a ``size`` x ``size`` atlas and ``count`` directions; what is traced is kept in the cache."""
        atlas = Atlas.of(stage.mesh, size, stage.device)
        directions = fibonacci_axes(count).to(stage.device)
        geometric, position = stage.surface.geometry(atlas.face, atlas.barycentric)
        normal = stage.surface(atlas.face, atlas.barycentric, position + geometric).normal
        above = geometric @ directions.T > 0
        key = mesh_key("landings_of_texels", stage.mesh, size, count, device=stage.device)
        traced = Cache().kept(key, lambda: _trace(stage, atlas, position + stage.surface.offset * geometric, directions, above))
        return cls(atlas, directions, position, normal, above, traced["landed"].to(stage.device))


@dataclass(frozen=True)
class IndirectLight:
    """What other parts of the object send to each texel of an atlas, as spherical Gaussians that see no shadow."""

    atlas: Atlas
    lobes: SphericalGaussians

    def at(self, uv: Tensor) -> SphericalGaussians:
        """The lobes of the texels at texture coordinates (N, 2)."""
        rows = self.atlas.nearest(uv).long()
        return SphericalGaussians(*(part[rows] for part in self.lobes))


def _trace(stage: Stage, atlas: Atlas, origin: Tensor, directions: Tensor, above: Tensor) -> dict[str, Tensor]:
    landed = []
    for part in torch.arange(len(origin), device=origin.device).split(TEXELS_AT_ONCE):
        toward = directions.expand(len(part), -1, -1).contiguous()
        face, barycentric, _ = stage.rays.intersect(origin[part], toward, above[part])
        landed.append(stage.surface.landed(toward, face, barycentric, atlas.row))
    return {"landed": torch.cat(landed).cpu()}
