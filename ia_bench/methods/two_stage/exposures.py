"""The factor by which each photograph was exposed, where nobody knows it."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

RATE = 0.02  # of Adam at the start, in log units


class Exposures:
    """Adam on one log factor per view, which multiplies the renders that its photograph is compared with.

    All factors and the light share one that images cannot tell: the mean of the logs is kept at 0, as
    ``Scene.exposures_differ`` says of the photographs.

    Attributes:
        log: (V,), the log factors so far.
    """

    def __init__(self, views: int, pixel_count: int, device: torch.device) -> None:
        """``pixel_count``: pixels of one view, by which the view of a flat index is told."""
        self.log = torch.zeros(views, device=device, requires_grad=True)
        self._pixel_count = pixel_count
        self._optimizer = torch.optim.Adam([self.log], betas=(0.9, 0.99))

    def factors(self, pixel: Tensor) -> Tensor:
        """The factors (N, 1) of flat indices (N,) into the stacked views, through which gradients flow."""
        return torch.exp(self.log[pixel // self._pixel_count])[:, None]

    def descend(self, fall: float) -> None:
        """One step at ``fall`` times RATE, back to factors whose geometric mean is 1."""
        gradient = self.log.grad
        if gradient is not None and bool(torch.isfinite(gradient.square().sum())):
            self._optimizer.param_groups[0]["lr"] = RATE * fall
            self._optimizer.step()
            with torch.no_grad():
                self.log -= self.log.mean()
        self.clear()

    def clear(self) -> None:
        """Forget the gradient."""
        self._optimizer.zero_grad(set_to_none=True)

    @property
    def recovered(self) -> Tensor:
        """The factors so far, (V,)."""
        return torch.exp(self.log.detach())

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint must keep beside the factors: Adam's moments."""
        return self._optimizer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over a :meth:`state_dict`."""
        self._optimizer.load_state_dict(state)
