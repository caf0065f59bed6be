"""What surface points see in fixed directions, traced once: the open sky, or another part of the object."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.cache import Cache
from ia_bench.render.atlas import Atlas, mesh_key
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.spherical_gaussians.environment import fibonacci_axes

TEXELS_AT_ONCE = 1024
WIDEST, NARROWEST = 0.1, 50.0  # sharpness of a reflected lobe whose visibility is asked for


@dataclass(frozen=True)
class Transport:
    """N texels of an atlas as points on the surface, and what lies in K directions from each.

    Attributes:
        atlas: The texels.
        directions: (K, 3), spread evenly over the sphere.
        position: (N, 3) of the texels, in scene units.
        normal: (N, 3), shading normals on the side from which triangles are wound counter-clockwise.
        above: (N, K) bool, whether a direction is above the texel's triangle.
        free: (N, K) bool, whether it is and nothing is in its way.
        landed: (N, K) int32, the texel that is in its way; -1 for none, and for the back of a triangle, which sends nothing.
    """

    atlas: Atlas
    directions: Tensor
    position: Tensor
    normal: Tensor
    above: Tensor
    free: Tensor
    landed: Tensor

    @classmethod
    def of(cls, stage: Stage, size: int, count: int) -> Transport:
        """Of a ``size`` x ``size`` atlas and ``count`` directions; what is traced is kept in the cache."""
        atlas = Atlas.of(stage.mesh, size, stage.device)
        directions = fibonacci_axes(count).to(stage.device)
        geometric, position = stage.surface.geometry(atlas.face, atlas.barycentric)
        normal = stage.surface(atlas.face, atlas.barycentric, position + geometric).normal
        above = geometric @ directions.T > 0
        key = mesh_key("directions_of_texels", stage.mesh, size, count)
        traced = Cache().kept(key, lambda: _trace(stage, atlas, position + stage.surface.offset * geometric, directions, above))
        free, landed = (traced[name].to(stage.device) for name in ("free", "landed"))
        return cls(atlas, directions, position, normal, above, free, landed)

    def rows(self, uv: Tensor) -> Tensor:
        """The texels (N,) at texture coordinates (N, 2)."""
        return self.atlas.nearest(uv).long()

    @torch.no_grad()
    def of_lobes(self, rows: Tensor, axis: Tensor, sharpness: Tensor) -> Tensor:
        """The share of M lobes that arrives at texels (R,): (R, M).

        The mean of ``free`` over all directions, weighted by the lobe's values.
        """
        return self.free[rows].float() @ self._weights(axis, sharpness[:, None]).T

    @torch.no_grad()
    def of_reflection(self, rows: Tensor, axis: Tensor, sharpness: Tensor) -> Tensor:
        """The same of one reflected lobe of each texel, (R, 3) and (R, 1): (R, 1)."""
        weights = self._weights(axis, sharpness.clamp(WIDEST, NARROWEST))
        return (self.free[rows] * weights).sum(1, keepdim=True)

    def _weights(self, axis: Tensor, sharpness: Tensor) -> Tensor:
        """A lobe's values in the K directions over their sum, however narrow it is: (M, K)."""
        return torch.softmax(sharpness * (axis @ self.directions.T - 1), 1)


def _trace(stage: Stage, atlas: Atlas, origin: Tensor, directions: Tensor, above: Tensor) -> dict[str, Tensor]:
    free, landed = [], []
    for part in torch.arange(len(origin), device=origin.device).split(TEXELS_AT_ONCE):
        toward = directions.expand(len(part), -1, -1).contiguous()
        face, barycentric, _ = stage.rays.intersect(origin[part], toward, above[part])
        free.append(above[part] & (face < 0))
        landed.append(stage.surface.landed(toward, face, barycentric, atlas.row))
    return {"free": torch.cat(free).cpu(), "landed": torch.cat(landed).cpu()}
