"""The texels of a mesh's UV atlas as points on its surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.cache import content_key, made_on
from ia_bench.render.embree import EmbreeRays
from ia_bench.scenes.scene import Mesh


@dataclass(frozen=True)
class Atlas:
    """The N texels of a square atlas whose centres lie on a triangle.

    ``place`` (N,) int64: flat index in the atlas; ``face`` (N,) int64 and ``barycentric`` (N, 2): the point on the mesh.
    ``row`` (size, size) int32: which of the N stands for a texel of the atlas, the nearest where the texel is none itself.
    """

    place: Tensor
    face: Tensor
    barycentric: Tensor
    row: Tensor

    @classmethod
    def of(cls, mesh: Mesh, size: int, device: torch.device) -> Atlas:
        """Found by rays through the UV plane."""
        flat = np.concatenate([mesh.uv, np.zeros_like(mesh.uv[:, :1])], 1)
        plane = EmbreeRays(Mesh(flat, mesh.faces, mesh.normals, mesh.uv))
        centres = (np.arange(size, dtype=np.float32) + 0.5) / size
        v, u = np.meshgrid(1 - centres, centres, indexing="ij")
        origins = torch.from_numpy(np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3).astype(np.float32))
        face, barycentric, _ = plane.intersect(origins, torch.tensor([0.0, 0.0, -1.0]).expand_as(origins).contiguous())
        place = torch.nonzero(face >= 0)[:, 0]
        row = _nearest(place, torch.arange(len(place)), size)
        return cls(place.to(device), face[place].to(device), barycentric[place].to(device), row.to(device))

    def keeping(self, kept: Tensor) -> Atlas:
        """The same texels, but only those of ``kept`` (N,) bool are ever found by a lookup; none kept changes nothing."""
        which = torch.nonzero(kept)[:, 0]
        if len(which) == 0:
            return self
        return replace(self, row=_nearest(self.place[which].cpu(), which.cpu(), len(self.row)).to(self.row.device))

    def nearest(self, uv: Tensor) -> Tensor:
        """The texel at (..., 2) texture coordinates: (...,) int32 in [0, N)."""
        size = len(self.row)
        column = (uv[..., 0] * size).long().clamp(0, size - 1)
        row = ((1 - uv[..., 1]) * size).long().clamp(0, size - 1)
        return self.row[row, column]


def _nearest(place: Tensor, texel: Tensor, size: int) -> Tensor:
    """For every texel of the atlas the one of ``texel`` (M,), which lie at ``place`` (M,), that is nearest: (size, size)."""
    from scipy.ndimage import distance_transform_edt

    row_of = np.zeros(size * size, np.int32)
    covered = np.zeros(size * size, bool)
    row_of[place.numpy()], covered[place.numpy()] = texel.numpy(), True
    nearest = distance_transform_edt(~covered.reshape(size, size), return_distances=False, return_indices=True)
    return torch.from_numpy(row_of.reshape(size, size)[tuple(nearest)])


def mesh_key(kind: str, mesh: Mesh, *sizes: int, device: torch.device) -> str:
    """The key under which a cache keeps what is baked on the ``device`` for the atlas of a mesh."""
    return content_key(made_on(device.type, kind), " ".join(map(str, sizes)), mesh.vertices, mesh.faces, mesh.uv)
