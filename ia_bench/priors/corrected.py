"""How good would a prior have to be? Another one with its own errors, made smaller by a known factor; and any prior around one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.files import paths_in
from ia_bench.common.ranges import UnitInterval
from ia_bench.priors.contract import Distiller, Observations, Prior, Refiner, Samples
from ia_bench.priors.validation import ask, ask_to_distill, check_prior_info


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
        return self.answered(observations, ask(self.prior, self.shown(observations), seed=seed, guidance=guidance))

    def _distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        assert isinstance(self.prior, Distiller)
        return self.answered(observations, ask_to_distill(self.prior, self.shown(observations), renders, seed=seed))

    def _refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        assert isinstance(self.prior, Refiner)
        return self.prior.refine(self.shown(observations), renders)


class CorrectedPrior(WrappedPrior):
    """sample = truth + ``share`` (sample of the prior ``of`` - truth), in linear values; ``share`` in [0, 1].

    ``share`` = 1 gives the prior's own samples, 0 the truth; between them every view keeps the kind of error that this prior
    makes (casts, baked shading, blotches, missed highlights) at -20 log10(share) dB more of linear PSNR. Guidance reaches the
    prior's sample before its error is made smaller, and so it is with what is distilled. ``of``: a prior's name or
    module:Class; ``of_options``: its options, where they are not those that a run by that name has.

    It sees ground truth, as the oracle does. Ceilings are those of the prior behind: what that one could not say still counts
    as "at least". Raises InputError for a prior that sees the truth itself, or that provides nothing.
    """

    @classmethod
    def resolved_options(cls, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options with those of the prior behind made explicit, where these depend on the machine."""
        plugin, given = _behind(options)
        resolve = getattr(registry.load(plugin), "resolved_options", None)
        return {**options, "of_options": given if resolve is None else resolve(given)}

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """What the samples of the prior behind depend on, and its code where it is not the package's own."""
        plugin, given = _behind(options)
        behind = getattr(registry.load(plugin), "files", None)
        weights = paths_in(given) if behind is None else behind(given)
        return [*weights, *(file for files in registry.sources(plugin).values() for file in files)]

    def __init__(self, *, of: str = "diffusion", share: UnitInterval = 0.5, of_options: Mapping[str, Any] | None = None) -> None:
        plugin, given = _behind({"of": of, "of_options": of_options})
        behind: Prior = registry.create("prior", of, plugin.target, given)
        check_prior_info(behind)
        if behind.info.sees_truth or not behind.info.provides:
            reason = "it provides nothing" if not behind.info.provides else "it sees the truth itself"
            raise InputError(f"prior.options.of: expected a prior whose errors can be corrected, found {of}: {reason}")
        super().__init__(behind)
        self.info = replace(behind.info, sees_truth=True, wants=behind.info.wants | {"truth"}, coupling="targets")
        self._share = share

    def shown(self, observations: Observations) -> Observations:
        """Everything but the truth."""
        return replace(observations, truth=None)

    def answered(self, observations: Observations, samples: Samples) -> Samples:
        """The samples between the truth and themselves."""
        truth = observations.truth or {}
        values = {name: torch.lerp(truth[name].to(sample), sample, self._share) for name, sample in samples.values.items()}
        return replace(samples, values=values)


def _behind(options: Mapping[str, Any]) -> tuple[registry.Plugin, dict[str, Any]]:
    """The prior that is corrected, and all options that it is made with."""
    plugin = registry.find("prior", options.get("of", "diffusion"))
    return plugin, {**plugin.options, **(options.get("of_options") or {})}
