"""The step in which light and albedo exchange a colour.

Images of a matt object cannot tell (albedo k, light / k) from (albedo, light). So one log factor per channel is optimised
along that direction, beside the steps of the two.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

MAX_WHITE = 0.01  # fraction of the observed texels that a step may leave beyond white ...
TEXELS = 16_384  # ... counted on about so many of them, evenly chosen


class ScaleAmbiguityStep:
    """Adam on c (3,): the albedo is multiplied by exp(-c), the light by exp(c).

    The diffuse part of an image stays as it is, so only highlights and interreflections tell c (docs/stiffness.md). Steps of
    the albedo and of the light of their own never find it: where one has moved and the other has not, the image is wrong first.
    The gradient along c follows from those of the two tensors, which the backward pass has anyway.

    A step that would leave more than MAX_WHITE of the texels beyond white is not taken in that channel (only there, so the
    others still move): against the bound of the albedo the two would no longer balance.

    Attributes:
        blocked: How many steps were not taken for that reason.
    """

    def __init__(self, albedo: Tensor, log_light: Tensor, observed: Tensor) -> None:
        """``albedo`` (T, T, 3) and ``log_light`` (H, W, 3) are changed in place; ``observed`` (T, T) bool: texels that count."""
        self._albedo, self._log_light = albedo, log_light
        texels = torch.nonzero(observed.reshape(-1))[:, 0]
        self._observed = texels[:: max(1, len(texels) // TEXELS)]
        self._factor = torch.zeros(3, device=albedo.device, requires_grad=True)
        self.optimizer = torch.optim.Adam([self._factor], betas=(0.9, 0.99))
        self.blocked = 0

    def gradient(self) -> Tensor:
        """The gradient (3,) of the loss with respect to c at c = 0, from the gradients of both tensors."""
        of_albedo, of_light = self._albedo.grad, self._log_light.grad
        if of_albedo is None or of_light is None:
            raise RuntimeError("a colour is exchanged along the gradients of albedo and light: call backward() first")
        return of_light.sum((0, 1)) - (of_albedo * self._albedo.detach()).sum((0, 1))

    @torch.no_grad()
    def __call__(self, rate: float) -> None:
        """Move both by a step of Adam at ``rate``, a log factor."""
        self._factor.grad = self.gradient()
        self.optimizer.param_groups[0]["lr"] = rate
        self.optimizer.step()
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
        return {"optimizer": self.optimizer.state_dict(), "blocked": self.blocked}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over a :meth:`state_dict`."""
        self.optimizer.load_state_dict(state["optimizer"])
        self.blocked = state["blocked"]
