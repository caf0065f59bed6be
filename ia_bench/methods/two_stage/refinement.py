"""What pictures of the surface show, brought to the places that they show: a prior's corrections, and what tells it of them."""

from __future__ import annotations

from copy import copy

import torch
from torch import Tensor

from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import fill_unobserved, splat
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Problem
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator

OFFSET = 0.01
"""It is added to both sides of a quotient of albedos, so that black ones have one."""


class Fusion:
    """Averages pictures of the surface over the pixels that show a texel.

    Each pixel is weighed by the cosine at which it sees the surface; those that the object covers in part are left out.

    Attributes:
        position: (P, 3), where the surface is that the pixels show.
    """

    def __init__(self, surface: SurfaceInterpolator, gbuffer: GBuffer) -> None:
        covered = torch.nonzero(gbuffer.filled)[:, 0]
        self._surface = surface
        self._pixel, self._face, self._barycentric = gbuffer.pixel[covered], gbuffer.face[covered], gbuffer.barycentric[covered]
        origin = gbuffer.seen_from(covered)
        middle = self._surface(self._face[:, 0].long(), self._barycentric[:, 0], origin)
        toward = origin - middle.position
        self.position = middle.position
        self._cosine = (middle.normal * toward).sum(-1, keepdim=True).clamp_min(0) / toward.norm(dim=-1, keepdim=True)

    @classmethod
    def of_photographs(cls, problem: Problem, views: tuple[int, ...]) -> Fusion:
        """Of some training ``views``."""
        return cls(problem.renderer.surface, restrict(problem.gbuffer, views)[0])

    def __bool__(self) -> bool:
        """Whether there is any such pixel."""
        return bool(len(self._pixel))

    def pixels(self, images: Tensor) -> Tensor:
        """The pixels (P, C) of images (V, H, W, C) that count."""
        return images.to(self._cosine.device).reshape(-1, images.shape[-1])[self._pixel]

    def drawn(self, most: int, generator: torch.Generator) -> Fusion:
        """The same of ``most`` of its pixels, drawn with the ``generator``; itself if it has no more."""
        if len(self._pixel) <= most:
            return self
        some, part = torch.randperm(len(self._pixel), generator=generator, device=self._pixel.device)[:most], copy(self)
        for name in ("position", "_pixel", "_face", "_barycentric", "_cosine"):
            setattr(part, name, getattr(self, name)[some])
        return part

    def looked_up(self, texture: Tensor) -> Tensor:
        """What the pixels show of a texture (T, T, C): (P, C)."""
        return self._surface.averaged(self._face, self._barycentric, texture)

    def mean(self, values: Tensor) -> Tensor:
        """(C,), over the pixels that ``values`` (P, C) belong to."""
        return (self._cosine * values).sum(0) / self._cosine.sum().clamp_min(1e-12)

    def texture(self, values: Tensor, size: int) -> Tensor:
        """``values`` (P, C) of the pixels as a texture (size, size, C); texels that none of them shows follow their neighbours."""
        channels = values.shape[1]
        uv = self._surface.uv(self._face.long(), self._barycentric)
        weighed = torch.cat([self._cosine * values, self._cosine], 1)[:, None].expand(-1, uv.shape[1], -1)
        summed, total = splat(uv.reshape(-1, 2), weighed.reshape(-1, channels + 1), size)
        known = (total > 0) & (summed[..., channels] > 0)
        return fill_unobserved(summed[..., :channels] / summed[..., channels:].clamp_min(1e-12), known)


def refined_albedo(fusion: Fusion, texture: Tensor, shown: Tensor, corrected: Tensor, share: float) -> Tensor:
    """The albedo ``texture`` (T, T, 3) as the pixels that show it were corrected from ``shown`` to ``corrected``, both (P, 3).

    A texel changes by the factor exp(share * mean of log((corrected + e) / (shown + e))) of albedos plus e = OFFSET. The mean
    factor of each channel is taken out, since no correction is asked about level and cast.
    """
    if not fusion:
        return texture
    change = torch.log(corrected.clamp_min(0) + OFFSET) - torch.log(shown.clamp_min(0) + OFFSET)
    mean = fusion.texture(change - fusion.mean(change), len(texture))
    return ((texture + OFFSET) * torch.exp(share * mean) - OFFSET).clamp(0, 1)


def refined_roughness(fusion: Fusion, texture: Tensor, shown: Tensor, corrected: Tensor, share: float) -> Tensor:
    """The roughness ``texture`` (T, T, 1) likewise, ``shown`` and ``corrected`` (P, 1): plus share * mean change."""
    if not fusion:
        return texture
    return (texture + share * fusion.texture(corrected - shown, len(texture))).clamp(MIN_ROUGHNESS, 1)
