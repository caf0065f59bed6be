"""No prior: the images alone, and every other prior's opponent."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from ia_bench.priors.contract import Observations, PriorInfo, Samples


class NoPrior:
    """Provides nothing; fitting uses the image loss and smoothness only."""

    info = PriorInfo(frozenset())

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """Nothing, for any input."""
        return Samples({})
