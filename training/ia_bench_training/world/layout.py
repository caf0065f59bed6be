"""What a world's folder holds, and how it is read: for machines that train on worlds and make none. Imports no renderer."""

from __future__ import annotations

import functools
import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.scenes.color import srgb_to_linear
from ia_bench_training.lights import HEIGHT, WIDTH

WORLD, BANKS, VIEWS = "world.json", "banks.safetensors", "views_{}_{:04d}.safetensors"
KINDS = ("procedural", "real")  # of views
DIRECTIONS = 512
"""Of light, spread evenly over the sphere: 9 degrees apart."""
SIDE, POINTS = 2, 4  # primary points of a pixel
MISS = 255  # the slot of a point that sees nothing
TILE, LEVELS = 128, 5  # texels along a side of a texture of the bank, and its versions, each half the size of the last ...
ATLAS, ATLAS_LEVELS = 256, 3  # ... and of a real mesh
LOBES = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
"""The roughness of each filtered map of a light; the first is the map itself."""


@functools.cache
def directions() -> Tensor:
    """The directions of light (DIRECTIONS, 3): a Fibonacci lattice on the sphere."""
    number = torch.arange(DIRECTIONS, dtype=torch.float64) + 0.5
    z = 1 - 2 * number / DIRECTIONS
    turn = number * math.pi * (3 - math.sqrt(5))
    radius = (1 - z * z).sqrt()
    return torch.stack([radius * turn.cos(), radius * turn.sin(), z], -1).float()


class Bank:
    """Textures with their smaller versions in one table on a device, repeated as in a mirror."""

    def __init__(self, stored: dict[str, Tensor], side: int, levels: int, device: torch.device) -> None:
        self._flat, self.mean = stored["flat"].to(device), stored["mean"].to(device)
        self.side, self.levels = side, levels
        sizes = [len(self.mean) * (side >> level) ** 2 for level in range(levels)]
        self._base = torch.tensor(np.cumsum([0, *sizes[:-1]]), device=device)
        self._decode = srgb_to_linear(torch.arange(256) / 255.0).to(device)

    def look_up(self, which: Tensor, uv: Tensor, spread: Tensor) -> Tensor:
        """Linear values (..., 5) of textures ``which`` (...) at ``uv`` (..., 2), of which 1 is a side, ``spread`` (...) wide."""
        level = torch.log2((spread * self.side).clamp_min(1e-6)).round().clamp(0, self.levels - 1).long()
        side = self.side >> level
        place = (uv - 2 * torch.floor(uv / 2) - 1).abs()  # a mirror at every edge
        texel = torch.minimum((place * side[..., None]).long(), side[..., None] - 1)
        found = self._flat[self._base[level] + (which * side + texel[..., 1]) * side + texel[..., 0]]
        return torch.cat([self._decode[found[..., :3].long()], found[..., 3:] / 255.0], -1)


def filtered(lights: Tensor, step: int = 32) -> Tensor:
    """Lights (L, HEIGHT, WIDTH, 3) of mean radiance 1, filtered by each of LOBES: (L, 3, len(LOBES), HEIGHT, WIDTH) float16."""
    if len(lights) > step:
        return torch.cat([filtered(part) for part in lights.split(step)])
    area = row_solid_angles(HEIGHT, WIDTH).float()[:, None]
    stack = lights.float().clamp_min(1e-5)
    mean = (stack.mean(-1) * area).sum((1, 2)) / (4 * math.pi)
    stack = (stack / mean[:, None, None, None]).movedim(-1, 1)  # (L, 3, H, W)
    maps = [stack]
    for roughness in LOBES[1:]:
        fine = roughness < 0.3
        source = stack if fine else F.avg_pool2d(stack * area, 2) * 4 / _coarse_area()
        blurred = source.flatten(2) @ _lobe(roughness, HEIGHT if fine else HEIGHT // 2)
        image = blurred.unflatten(-1, source.shape[-2:])
        if not fine:
            image = F.interpolate(image, (HEIGHT, WIDTH), mode="bilinear", align_corners=False)
        maps.append(image)
    return torch.stack(maps, 2).clamp(max=60000).half()


def _coarse_area() -> Tensor:
    return row_solid_angles(HEIGHT // 2, WIDTH // 2).float()[:, None]


@functools.cache
def _lobe(roughness: float, rows: int) -> Tensor:
    """(T, T): what texel i of a map adds to texel k of the filtered one, for a surface seen along its normal (Karis 2013)."""
    around = texel_centres(rows, 2 * rows).reshape(-1, 3)
    area = row_solid_angles(rows, 2 * rows).float().repeat_interleave(2 * rows)
    cosine = around @ around.T
    half = (1 + cosine).clamp_min(0) / 2  # squared cosine of the half angle
    alpha2 = roughness**4
    weight = cosine.clamp_min_(0) * area[:, None] / (half * (alpha2 - 1) + 1).square_()
    return weight / weight.sum(0, keepdim=True)
