"""No prior: the images alone, and every other prior's opponent."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor


class NoPrior:
    """Provides nothing; fitting uses the image loss and smoothness only."""

    provides: frozenset[str] = frozenset()
    stochastic = False
    guidable = False
    resolution: int | None = None
    encoding: Mapping[str, str] = {}
    sees_truth = False
    network_calls = 0

    def sample(
        self, images: Tensor, masks: Tensor, *, seed: int, guidance: Mapping[str, Tensor] | None = None
    ) -> dict[str, Tensor]:
        """Nothing, for any input."""
        return {}
