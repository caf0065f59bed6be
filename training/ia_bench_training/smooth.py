"""Takes Monte-Carlo noise out of diffuse shading without touching texture: a joint bilateral filter of the irradiance."""

from __future__ import annotations

import torch
from torch import Tensor

RADIUS = 2  # pixels
SPATIAL, NORMAL, RANGE = 1.5, 0.2, 0.25
"""Standard deviations: pixels, length of the difference of unit normals, difference of log irradiance."""


def smooth_shading(diffuse: Tensor, albedo: Tensor, normal: Tensor, visibility: Tensor, coverage: Tensor) -> tuple[Tensor, Tensor]:
    """Filter diffuse radiance (V, H, W, 3) and sky visibility (V, H, W, 1), all premultiplied; returned likewise.

    Averaged is diffuse radiance over albedo, among pixels within RADIUS of similar normal and similar irradiance, so that
    texture, creases and shadows keep their edges. ``albedo``, ``normal`` (V, H, W, 3); ``coverage`` (V, H, W, 1).
    """
    shading = diffuse / albedo.clamp_min(1e-6)
    level = torch.log(shading.mean(-1, keepdim=True) + 1e-3)
    facing = normal / coverage.clamp_min(1e-6)
    open_share = visibility / coverage.clamp_min(1e-6)
    guide = torch.cat([facing / NORMAL, level / RANGE], -1)
    values = torch.cat([shading, open_share], -1)
    total, weights = torch.zeros_like(values), torch.zeros_like(coverage)
    for down in range(-RADIUS, RADIUS + 1):
        for right in range(-RADIUS, RADIUS + 1):
            here, there = _overlap(down, right)
            difference = (guide[here] - guide[there]).square().sum(-1, keepdim=True) + (down**2 + right**2) / SPATIAL**2
            weight = coverage[there] * torch.exp(-0.5 * difference)
            total[here] += weight * values[there]
            weights[here] += weight
    filtered = total / weights.clamp_min(1e-6)
    return filtered[..., :3] * albedo, filtered[..., 3:] * coverage


def _overlap(down: int, right: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of (V, H, W, C) images: the pixels that have a neighbour at that offset, and these neighbours."""
    rows, columns = (slice(max(-step, 0), -step if step > 0 else None) for step in (down, right))
    moved_rows, moved_columns = (slice(max(step, 0), step if step < 0 else None) for step in (down, right))
    every = slice(None)
    return (every, rows, columns, every), (every, moved_rows, moved_columns, every)
