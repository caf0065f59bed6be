"""What is known in the pixels of photographs, brought to the texels that they show."""

from __future__ import annotations

from copy import copy

import torch
from torch import Tensor

from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.contract import Problem
from ia_bench.methods.photographs import restrict

OFFSET = 0.01
"""It is added to both sides of a quotient of albedos, so that black ones have one."""


class Fusion:
    """Averages images of some training ``views`` over the pixels that show a texel.

    Each pixel is weighed by the cosine at which it sees the surface; those that the object covers in part are left out, and
    those that the photograph's mask leaves out, of which a prior has been shown nothing.

    Attributes:
        problem, views: What it was made of.
        entries: (P,), which pixels of the problem's G-buffer count.
        position: (P, 3), where the surface is that they show.
    """

    def __init__(self, problem: Problem, views: tuple[int, ...]) -> None:
        part, rows = restrict(problem.gbuffer, views)
        covered = torch.nonzero(part.filled & ~problem.photographs.left_out[rows])[:, 0]
        self.problem, self.views, self.entries = problem, views, rows[covered]
        self._surface, self._gbuffer = problem.renderer.surface, part.at(covered)
        origin = self._gbuffer.seen_from()
        middle = self._surface(self._gbuffer.face[:, 0], self._gbuffer.barycentric[:, 0], origin)
        toward = origin - middle.position
        self.position = middle.position
        self._cosine = (middle.normal * toward).sum(-1, keepdim=True).clamp_min(0) / toward.norm(dim=-1, keepdim=True)

    def __bool__(self) -> bool:
        """Whether there is any such pixel."""
        return bool(len(self.entries))

    def pixels(self, images: Tensor) -> Tensor:
        """The pixels (P, C) of images (V, H, W, C) that count."""
        return images.to(self._cosine.device).reshape(-1, images.shape[-1])[self._gbuffer.pixel]

    def drawn(self, most: int, generator: torch.Generator) -> Fusion:
        """The same of ``most`` of its pixels, drawn with the ``generator``; itself if it has no more."""
        if len(self.entries) <= most:
            return self
        some, part = torch.randperm(len(self.entries), generator=generator, device=self.entries.device)[:most], copy(self)
        part.entries, part._gbuffer = self.entries[some], self._gbuffer.at(some)
        part.position, part._cosine = self.position[some], self._cosine[some]
        return part

    def looked_up(self, texture: Tensor) -> Tensor:
        """What the pixels show of a texture (T, T, C): (P, C)."""
        return self._surface.averaged(self._gbuffer.face, self._gbuffer.barycentric, texture)

    def moved(self, material: Material, albedo: tuple[Tensor, Tensor, float], roughness: tuple[Tensor, Tensor, float]) -> Material:
        """The ``material`` moved from what the pixels show of it to what they should show: both (P, C), and a share of the way.

        An albedo changes by the factor exp(share * mean of log((wanted + e) / (shown + e))) of albedos plus e = OFFSET; the mean
        factor of each channel is taken out, since level and colour are the light's to find. A roughness changes by share * mean
        of wanted - shown. What comes back may be out of its range.
        """
        size = len(material.albedo)
        shown, wanted, share = albedo
        change = torch.log(wanted.clamp_min(0) + OFFSET) - torch.log(shown.clamp_min(0) + OFFSET)
        factor = torch.exp(share * self.texture(change - self.mean(change), size))
        shown, wanted, share = roughness
        moved = material.roughness + share * self.texture(wanted - shown, size)
        return Material((material.albedo + OFFSET) * factor - OFFSET, moved, material.metallic)

    def mean(self, values: Tensor) -> Tensor:
        """(C,), over the pixels that ``values`` (P, C) belong to."""
        return (self._cosine * values).sum(0) / self._cosine.sum().clamp_min(1e-12)

    def texture(self, values: Tensor, size: int) -> Tensor:
        """``values`` (P, C) of the pixels as a texture (size, size, C); texels that none of them shows follow their neighbours."""
        channels = values.shape[1]
        uv = self._surface.uv(self._gbuffer.face.long(), self._gbuffer.barycentric)
        weighed = torch.cat([self._cosine * values, self._cosine], 1)[:, None].expand(-1, uv.shape[1], -1)
        summed, total = splat(uv.reshape(-1, 2), weighed.reshape(-1, channels + 1), size)
        known = (total > 0) & (summed[..., channels] > 0)
        return fill_unobserved(summed[..., :channels] / summed[..., channels:].clamp_min(1e-12), known)
