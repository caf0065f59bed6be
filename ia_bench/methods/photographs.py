"""What the training photographs show in the pixels of a G-buffer, and how far each of them can be believed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.methods.bounds import known_pixels
from ia_bench.render.gbuffer import GBuffer
from ia_bench.scenes.scene import Scene

INSIDE = 0.5
"""A mask of no more than that leaves a pixel out."""


@dataclass(frozen=True)
class Photographs:
    """The P pixels in which training cameras see the mesh, as the photographs have them.

    Attributes:
        radiance: (P, 3), linear, premultiplied by the mask.
        mask: (P, 1), the share of the pixel that the object fills, as the photograph's mask has it.
        known: (P, 1) bool, where the radiance is not a lower bound alone; None for everywhere.
        left_out: (P,) bool, where the mesh fills the pixel and the mask leaves it out: wrong masks and poses, a margin that a
            capture cuts off, a mesh that is too large. Nothing that was made of the photograph says anything there.
    """

    radiance: Tensor
    mask: Tensor
    known: Tensor | None
    left_out: Tensor

    @classmethod
    def of(cls, scene: Scene, gbuffer: GBuffer) -> Photographs:
        """Those of a ``scene``, whose training cameras the ``gbuffer`` is of; on its device."""

        def pixels(images: Tensor) -> Tensor:
            return images.to(gbuffer.pixel.device).reshape(-1, images.shape[-1])[gbuffer.pixel]

        radiance = pixels(torch.stack([torch.from_numpy(view.image) for view in scene.train]))
        mask = pixels(torch.stack([torch.from_numpy(view.mask) for view in scene.train])[..., None])
        known = known_pixels(scene.train)
        return cls(radiance, mask, None if known is None else pixels(known), gbuffer.filled & (mask[:, 0] <= INSIDE))
