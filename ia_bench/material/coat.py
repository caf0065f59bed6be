"""What the specular lobe reflects in all, and so keeps from the diffuse one below it."""

from __future__ import annotations

import functools
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key
from ia_bench.material import brdf
from ia_bench.material.brdf import MIN_COSINE, MIN_ROUGHNESS, sample_visible_ggx, specular_brdf_cosine, visible_ggx_pdf

GRID = 32
SAMPLES = 1024
GOLDEN = 0.6180339887498949  # fraction of the golden ratio: its multiples fill [0, 1] evenly


@functools.cache
def coat_reflectance(size: int = GRID, samples: int = SAMPLES) -> Tensor:
    """The directional albedo of the specular lobe, (size, size): rows are roughness, columns the cosine, both from 0 to 1.

    The table is kept in the cache, for this code and that of the lobe.
    """
    code = (Path(file).read_text(encoding="utf-8") for file in (__file__, brdf.__file__))
    return Cache().kept(content_key("coat", f"{size} {samples}", *code), lambda: {"table": _tabulated(size, samples)})["table"]


def _tabulated(size: int, samples: int) -> Tensor:
    values = torch.linspace(0, 1, size)
    roughness, cosine = (grid[..., None, None] for grid in torch.meshgrid(values, values, indexing="ij"))
    cosine = cosine.clamp_min(MIN_COSINE)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(size, size, samples, 3)
    view = torch.cat([torch.sqrt(1 - cosine * cosine), torch.zeros_like(cosine), cosine], -1).expand(normal.shape)
    index = torch.arange(samples, dtype=torch.float64)
    u = torch.stack([(index + 0.5) / samples, torch.remainder((index + 0.5) * GOLDEN, 1)], -1).float()
    rough = roughness.clamp_min(MIN_ROUGHNESS).expand(size, size, samples, 1)
    incident = sample_visible_ggx(normal, view, rough, u)
    density = visible_ggx_pdf(normal, view, incident, rough)
    value = specular_brdf_cosine(normal, view, incident, rough) / density.clamp_min(1e-12)
    return torch.where(density > 0, value, torch.zeros_like(value)).mean(2)[..., 0]
