"""A light filtered by lobes that turn with the direction: the maps that split-sum shading looks up, linear in the light.

Both kernels depend on the angle between two directions alone. So on a lat-long map a filter is a convolution along the rows of
texels, with one kernel for every pair of rows, and a product in the frequencies of the azimuth.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.light.latlong import row_solid_angles, texel_centres, texel_to_direction

ROUGHNESS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # of the filtered maps; the first is the light itself
SIDE = 4  # points along a side of a texel at which a kernel is taken: lobes may be narrower than texels
Kernel = Callable[[Tensor], Tensor]


def cosine_kernel(cosine: Tensor) -> Tensor:
    """The clamped cosine: filtered by it, a light is its irradiance over pi, the radiance that a white matt surface sends."""
    return cosine.clamp_min(0)


def lobe_kernel(roughness: float) -> Kernel:
    """D(h) (n.l) of the GGX lobe seen along its own axis, v = n (Karis 2013), of the angle between n and l."""
    alpha2 = roughness**4

    def kernel(cosine: Tensor) -> Tensor:
        half2 = (1 + cosine) / 2  # (n.h)^2, where h bisects n and l
        return cosine.clamp_min(0) * alpha2 / (half2 * (alpha2 - 1) + 1).square()

    return kernel


@functools.cache
def filters(rows: int) -> tuple[Tensor, Tensor]:
    """Filters of a light of ``rows`` rows, in the frequencies of the azimuth: complex (F, rows, rows), F = rows + 1.

    The first turns it into irradiance over pi, the second, (len(ROUGHNESS) - 1, F, rows, rows), into the maps by roughness but the
    light itself. Each sums to 1: a white light stays white.
    """
    return _filter(rows, cosine_kernel), torch.stack([_filter(rows, lobe_kernel(roughness)) for roughness in ROUGHNESS[1:]])


def _filter(rows: int, kernel: Kernel) -> Tensor:
    columns = 2 * rows
    place = (torch.arange(SIDE, dtype=torch.float64) + 0.5) / SIDE
    u, v = (grid.reshape(-1, 1) for grid in torch.meshgrid(place, place, indexing="ij"))
    texel = torch.arange(rows * columns)
    inside = texel_to_direction(texel, u, v, rows, columns)  # (SIDE^2, T, 3)
    axis = texel_centres(rows, columns)[:, 0].double()  # of the first column: all others are turns of it
    weight = torch.stack([kernel(inside @ n).mean(0) for n in axis])  # (rows, T)
    weight = weight * row_solid_angles(rows, columns).repeat_interleave(columns)
    weight = (weight / weight.sum(1, keepdim=True)).reshape(rows, rows, columns)
    return torch.fft.rfft(weight, dim=-1).conj().permute(2, 0, 1).to(torch.complex64).contiguous()


class PrefilteredLight:
    """A light as split-sum shading asks it: for irradiance by normals, for filtered radiance by directions and roughness."""

    def __init__(self, radiance: Tensor) -> None:
        """``radiance`` (H, 2 H, 3), differentiable."""
        rows, columns, _ = radiance.shape
        matt, glossy = (part.to(radiance.device) for part in filters(rows))
        spectrum = torch.fft.rfft(radiance, dim=1).transpose(0, 1)  # (F, rows, 3)
        filtered = torch.fft.irfft(torch.cat([matt[None], glossy]) @ spectrum, n=columns, dim=1).transpose(1, 2)
        self._irradiance = _wrapped(filtered[:1])
        self._levels = _wrapped(torch.cat([radiance[None], filtered[1:]]))

    def irradiance(self, normal: Tensor) -> Tensor:
        """Irradiance over pi, (N, 3), of surfaces with unit ``normal`` (N, 3)."""
        return _look_up(self._irradiance, normal, torch.zeros_like(normal[:, :1]))

    def glossy(self, direction: Tensor, roughness: Tensor) -> Tensor:
        """The light (N, 3) as the lobe of ``roughness`` (N, 1) around unit ``direction`` (N, 3) sees it; linear between maps."""
        return _look_up(self._levels, direction, roughness * 2 - 1)


def _wrapped(maps: Tensor) -> Tensor:
    """Maps (L, H, W, 3) as (1, 3, L, H + 2, W + 2): with a texel more on every side, across the seam and across the poles."""
    across = maps.shape[2] // 2
    top, bottom = (maps[:, row : row + 1].roll(across, 2) for row in (0, maps.shape[1] - 1))
    tall = torch.cat([top, maps, bottom], 1)
    return torch.cat([tall[:, :, -1:], tall, tall[:, :, :1]], 2).permute(3, 0, 1, 2)[None]


def _look_up(maps: Tensor, direction: Tensor, level: Tensor) -> Tensor:
    """Linear between texels and between levels; ``level`` (N, 1) from -1, the first, to 1, the last."""
    rows, columns = maps.shape[3] - 2, maps.shape[4] - 2
    x, y, z = direction.unbind(-1)
    row = torch.acos(z.clamp(-1, 1)) * (2 / math.pi) - 1
    column = -torch.atan2(y, x) / math.pi  # phi falls from pi to -pi along a row
    place = torch.stack([column * (columns / (columns + 2)), row * (rows / (rows + 2)), level[:, 0]], -1)
    if maps.shape[2] == 1:
        return grid_sample(maps[:, :, 0], place[None, :, None, :2], align_corners=False)[0, :, :, 0].T
    # Levels lie at the ends of [-1, 1], texels at the middles of theirs.
    levels = maps.shape[2]
    place = torch.cat([place[:, :2], place[:, 2:] * ((levels - 1) / levels)], -1)
    return grid_sample(maps, place[None, :, None, None], align_corners=False)[0, :, :, 0, 0].T
