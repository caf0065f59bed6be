"""The colour that light and paint share: one step for both together, along what images hardly tell."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

MAX_WHITE = 0.01  # fraction of the observed texels that a step may leave beyond white ...
TEXELS = 16_384  # ... counted on about so many of them, evenly chosen


class CastStep:
    """Adam on a log factor (3,), one a channel, that the light takes from the albedo.

    Albedo times exp(-c) under light times exp(c) gives the same diffuse images, so only highlights and interreflections tell
    c (docs/stiffness.md). A step of every texel of its own never finds it: where the albedo has moved and the light has not,
    the image is wrong first. Along c both move at once and the diffuse part of the loss is silent; the gradient follows from
    those of the two tensors, which the backward pass has anyway.

    A step that would leave more than MAX_WHITE of the texels beyond white is not taken in that channel (only there, so the
    others still move): against the bound of the albedo the two would no longer balance. ``blocked`` counts these steps.
    """

    def __init__(self, albedo: Tensor, log_light: Tensor, observed: Tensor) -> None:
        """``albedo`` (T, T, 3) and ``log_light`` (H, W, 3) are changed in place; ``observed`` (T, T) bool: texels that count."""
        self._albedo, self._log_light = albedo, log_light
        texels = torch.nonzero(observed.reshape(-1))[:, 0]
        self._observed = texels[:: max(1, len(texels) // TEXELS)]
        self._factor = torch.zeros(3, device=albedo.device, requires_grad=True)
        self._optimizer = torch.optim.Adam([self._factor], betas=(0.9, 0.99))
        self.blocked = 0

    def gradient(self) -> Tensor:
        """Of the loss with respect to c (3,) at c = 0, from the gradients of both tensors."""
        of_albedo, of_light = self._albedo.grad, self._log_light.grad
        if of_albedo is None or of_light is None:
            raise RuntimeError("a step of the cast needs the gradients of albedo and light: call backward() first")
        return of_light.sum((0, 1)) - (of_albedo * self._albedo.detach()).sum((0, 1))

    @torch.no_grad()
    def __call__(self, rate: float) -> None:
        """Move both by a step of Adam at ``rate``, a log factor."""
        self._factor.grad = self.gradient()
        self._optimizer.param_groups[0]["lr"] = rate
        self._optimizer.step()
        if len(self._observed):
            moved = self._albedo.reshape(-1, 3)[self._observed] * torch.exp(-self._factor)
            blocked = ((moved > 1).float().mean(0) > MAX_WHITE) & (self._factor < 0)
            self._factor[blocked] = 0
            self.blocked += bool(blocked.any())
        self._log_light.add_(self._factor)
        self._albedo.mul_(torch.exp(-self._factor))
        self._factor.zero_()

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint must keep: Adam's moments and the count."""
        return {"optimizer": self._optimizer.state_dict(), "blocked": self.blocked}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over a :meth:`state_dict`."""
        self._optimizer.load_state_dict(state["optimizer"])
        self.blocked = state["blocked"]
