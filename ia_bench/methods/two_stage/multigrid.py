"""Steps at coarser scales, beside those of single texels.

Adam moves every texel by its own gradient, which is mostly noise: a batch of pixels sees a texel a few times in a fit. What many
texels have wrong together (a side of the object, a lamp and what surrounds it) shows in the sum of their gradients long before.
So images of half, a quarter, an eighth ... of the resolution are optimised as well, and what they move is added to the texels,

    x  <-  x + U1 (d1 + U2 (d2 + U3 (d3 + ...))),    d_k = step of Adam by the sum of the gradients below each texel of level k

where U doubles the resolution bilinearly: the multigrid idea of taking each error at the scale on which it is smooth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

LEAST_SIDE = 4  # rows of the coarsest level at least: fewer are the mean, which light and albedo exchange (scale_ambiguity.py)


class MultigridSteps:
    """Adam at half the resolution of some images and below, down to LEAST_SIDE rows; the images are changed in place.

    Neighbours in a texture need not be neighbours on the object: a step of one chart moves the border of the next one a little,
    whose own texels bring it back.
    """

    def __init__(self, images: Mapping[str, Tensor], betas: tuple[float, float]) -> None:
        """``images``: leaves (H, W, C) by name; one with an odd side has no coarser levels beyond it. ``betas``: of Adam."""
        self._images = dict(images)
        self._levels = {name: levels for name, image in images.items() if (levels := _levels(image))}
        groups = [{"params": levels, "lr": 0.0} for levels in self._levels.values()]
        self.optimizer = torch.optim.Adam(groups, betas=betas, fused=True) if groups else None

    @torch.no_grad()
    def __call__(self, rates: Mapping[str, float], gradients: Mapping[str, Tensor | None]) -> None:
        """Move every image that has one of the ``rates`` and of the ``gradients`` (H, W, C) by a step at each of its levels."""
        moving = [name for name in self._levels if rates.get(name) and gradients.get(name) is not None]
        if self.optimizer is None or not moving:
            return
        for (name, levels), group in zip(self._levels.items(), self.optimizer.param_groups, strict=True):
            group["lr"] = rates.get(name, 0.0)
            gradient = gradients.get(name)
            for level in levels:
                gradient = _summed(gradient) if name in moving and gradient is not None else None
                level.grad = gradient
        self.optimizer.step()
        for name in moving:
            step = torch.zeros_like(self._levels[name][-1])
            for level in reversed(self._levels[name]):
                step = _doubled(step + level)
                level.zero_()
            self._images[name].add_(step)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint must keep: Adam's moments."""
        return {} if self.optimizer is None else self.optimizer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over a :meth:`state_dict`."""
        if self.optimizer is not None:
            self.optimizer.load_state_dict(state)


def _levels(image: Tensor) -> list[Tensor]:
    """Zeros of half the resolution (H / 2, W / 2, C), a quarter, ... as leaves, the finest first."""
    height, width, channels = image.shape
    levels = []
    while height % 2 == 0 and width % 2 == 0 and height // 2 >= LEAST_SIDE:
        height, width = height // 2, width // 2
        levels.append(torch.zeros(height, width, channels, device=image.device, requires_grad=True))
    return levels


def _summed(image: Tensor) -> Tensor:
    """The sums of 2 x 2 texels: (H, W, C) to (H / 2, W / 2, C)."""
    return (4 * avg_pool2d(image.permute(2, 0, 1)[None], 2))[0].permute(1, 2, 0).contiguous()


def _doubled(image: Tensor) -> Tensor:
    """(H, W, C) to (2 H, 2 W, C), bilinearly."""
    return interpolate(image.permute(2, 0, 1)[None], scale_factor=2, mode="bilinear", align_corners=False)[0].permute(1, 2, 0)
