"""The steps that a fit takes beside those of single texels: at coarser scales, and along the scale ambiguity."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import pairwise

import torch
from torch import Tensor

from ia_bench.common.warp_launch import launch
from ia_bench.methods.two_stage.kernels import add_doubled

LEAST_SIDE = 4  # rows of the coarsest level at least: fewer are the mean, which light and albedo exchange (ScaleAmbiguityStep)
MAX_WHITE = 0.01  # fraction of the observed texels that a step may leave beyond white ...
TEXELS = 16_384  # ... counted on about so many of them, evenly chosen


# ---- coarser scales -------------------------------------------------------------------------------------------


class MultigridSteps:
    """Adam at half the resolution of some images and below, down to LEAST_SIDE rows; the images are changed in place.

    Adam moves every texel by its own gradient, which is mostly noise: a batch of pixels sees a texel a few times in a fit. What
    many texels have wrong together (a side of the object, a lamp and what surrounds it) shows in the sum of their gradients long
    before. So images of half, a quarter, an eighth ... of the resolution are optimised too, and what they move is added to texels,

        x  <-  x + U1 (d1 + U2 (d2 + U3 (d3 + ...))),    d_k = step of Adam by the sum of the gradients below each texel of level k

    where U doubles the resolution bilinearly: the multigrid idea of taking each error at the scale on which it is smooth.

    Neighbours in a texture need not be neighbours on the object: a step of one chart moves the border of the next one a little,
    whose own texels bring it back.
    """

    def __init__(self, images: Mapping[str, Tensor], betas: tuple[float, float], *, wrapped: Collection[str] = ()) -> None:
        """``images``: leaves (H, W, C) by name; one with an odd side has no coarser levels beyond it. ``betas``: of Adam.

        ``wrapped``: names of lat-long maps, whose last column lies beside the first one.
        """
        self._images, self._wrapped = dict(images), frozenset(wrapped)
        self._levels = {name: levels for name, image in images.items() if (levels := _levels(image))}
        groups = [{"params": levels, "lr": 0.0} for levels in self._levels.values()] or [{"params": []}]
        self.optimizer = torch.optim.Adam(groups, betas=betas, fused=True)

    @torch.no_grad()
    def __call__(self, rates: Mapping[str, float], gradients: Mapping[str, Tensor | None]) -> None:
        """Move every image that has one of the ``rates`` and of the ``gradients`` (H, W, C) by a step at each of its levels."""
        moving = [name for name in self._levels if rates.get(name) and gradients.get(name) is not None]
        if not moving:
            return
        for (name, levels), group in zip(self._levels.items(), self.optimizer.param_groups, strict=True):
            group["lr"] = rates.get(name, 0.0)
            gradient = gradients[name] if name in moving else None
            for level in levels:
                gradient = None if gradient is None else _halved(gradient)
                level.grad = gradient
        self.optimizer.step()
        for name in moving:
            for fine, coarse in reversed(list(pairwise([self._images[name], *self._levels[name]]))):
                flat = coarse.view(-1), *coarse.shape, int(name in self._wrapped), fine.view(-1)
                launch(add_doubled, len(fine), *flat, device=fine.device)
                coarse.zero_()


def _halved(image: Tensor) -> Tensor:
    """The sums over 2 x 2 texels of (H, W, C): (H / 2, W / 2, C)."""
    height, width, channels = image.shape
    rows = image.reshape(height // 2, 2, width * channels)
    pairs = (rows[:, 0] + rows[:, 1]).view(height // 2, width // 2, 2, channels)
    return pairs[:, :, 0] + pairs[:, :, 1]


def _levels(image: Tensor) -> list[Tensor]:
    """Zeros of half the resolution (H / 2, W / 2, C), a quarter, ... as leaves, the finest first."""
    height, width, channels = image.shape
    levels = []
    while height % 2 == 0 and width % 2 == 0 and height // 2 >= LEAST_SIDE:
        height, width = height // 2, width // 2
        levels.append(torch.zeros(height, width, channels, device=image.device, requires_grad=True))
    return levels


# ---- scale ambiguity ------------------------------------------------------------------------------------------


class ScaleAmbiguityStep:
    """Adam on c (3,), one log factor a channel: the albedo is multiplied by exp(-c), the light by exp(c).

    Images of a matt object cannot tell (albedo k, light / k) from (albedo, light).
    The diffuse part of an image stays as it is, so only highlights and interreflections tell c (docs/log/stiffness.md). Steps of
    the albedo and of the light of their own never find it: where one has moved and the other has not, the image is wrong first.
    The gradient along c follows from those of the two tensors, which the backward pass has anyway.

    A step that would leave more than MAX_WHITE of the texels beyond white is not taken in that channel (only there, so the
    others still move): against the bound of the albedo the two would no longer balance.
    """

    def __init__(self, albedo: Tensor, log_light: Tensor, observed: Tensor) -> None:
        """``albedo`` (T, T, 3) and ``log_light`` (H, W, 3) are changed in place; ``observed`` (T, T) bool: texels that count."""
        self._albedo, self._log_light = albedo, log_light
        texels = torch.nonzero(observed.reshape(-1))[:, 0]
        self._observed = texels[:: max(1, len(texels) // TEXELS)]
        self._factor = torch.zeros(3, device=albedo.device, requires_grad=True)
        self.optimizer = torch.optim.Adam([self._factor], betas=(0.9, 0.99), fused=True)

    def gradient(self) -> Tensor:
        """The gradient (3,) of the loss with respect to c at c = 0, from the gradients of both tensors."""
        of_albedo, of_light = self._albedo.grad, self._log_light.grad
        if of_albedo is None or of_light is None:
            raise RuntimeError("the scale-ambiguity step needs the gradients of albedo and light: call backward() first")
        return of_light.sum((0, 1)) - (of_albedo * self._albedo.detach()).sum((0, 1))

    @torch.no_grad()
    def __call__(self, rate: float) -> bool:
        """Move both by a step of Adam at ``rate``, a log factor; whether it was blocked in some channel."""
        self._factor.grad = self.gradient()
        self.optimizer.param_groups[0]["lr"] = rate
        self.optimizer.step()
        moved = self._albedo.reshape(-1, 3)[self._observed] * torch.exp(-self._factor)
        blocked = ((moved > 1).float().mean(0) > MAX_WHITE) & (self._factor < 0)  # a mean of none is NaN, which blocks nothing
        self._factor[blocked] = 0
        self._log_light.add_(self._factor)
        self._albedo.flatten(1).mul_(torch.exp(-self._factor).repeat(self._albedo.shape[1]))  # whole rows take a tenth of the time
        self._factor.zero_()
        return bool(blocked.any())
