"""A prior around another one, which changes what that one is shown and what it answers."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from ia_bench.priors.contract import Distiller, Observations, Prior, Refiner, Samples


class WrappedPrior:
    """Base of priors around ``prior``: a sample and a distilled estimate pass through the same two changes.

    It can be distilled, and refines, where the prior behind it does. A refined material passes as it is: nobody knows a true
    roughness. It has no fingerprint, so that its samples are not kept.
    """

    def __init__(self, prior: Prior) -> None:
        self.prior, self.info = prior, prior.info
        # Members of this object alone: what the class has, every wrapped prior would offer.
        if isinstance(prior, Distiller):
            self.distill = self._distill
        if isinstance(prior, Refiner):
            self.refine = self._refine

    def shown(self, observations: Observations) -> Observations:
        """What the prior behind is shown instead of ``observations``."""
        return observations

    def answered(self, observations: Observations, samples: Samples) -> Samples:
        """What is answered instead of the ``samples`` of the prior behind."""
        return samples

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`."""
        samples = self.prior.sample(self.shown(observations), seed=seed, guidance=guidance)
        return self.answered(observations, samples)

    def _distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        assert isinstance(self.prior, Distiller)
        return self.answered(observations, self.prior.distill(self.shown(observations), renders, seed=seed))

    def _refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        assert isinstance(self.prior, Refiner)
        return self.prior.refine(self.shown(observations), renders)
