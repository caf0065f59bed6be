"""How good would a prior have to be? Another prior with its own errors, made smaller by a known factor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Counted, GeometryReader, Patchwise, Prior
from ia_bench.priors.truth import RevealedTruth
from ia_bench.scenes.scene import View


class CorrectedPrior:
    """sample = truth + ``share`` (sample of the prior ``of`` - truth), in linear values; ``share`` in [0, 1].

    ``share`` = 1 gives the prior's own samples, 0 the truth; between them every view keeps the kind of error that this prior
    makes (casts, baked shading, blotches, missed highlights) at -20 log10(share) dB more of linear PSNR. Guidance reaches the
    prior's sample before its error is made smaller. ``of``: a prior's name or module:Class; ``of_options``: its options.

    It sees ground truth, as the oracle does. Samples have no ceiling (:class:`ia_bench.priors.contract.Bounded`), even
    where the prior's own end at one. Raises InputError for a prior that sees the truth itself, or that provides nothing.
    """

    sees_truth = True

    def __init__(self, *, of: str = "diffusion", share: float = 0.5, of_options: Mapping[str, Any] | None = None) -> None:
        if not (math.isfinite(share) and 0 <= share <= 1):
            raise InputError(f"prior.options.share: expected a number from 0 to 1, found {share}")
        self._prior: Prior = registry.create("prior", of, registry.find("prior", of).target, of_options or {})
        if self._prior.sees_truth or not self._prior.provides:
            reason = "it provides nothing" if not self._prior.provides else "it sees the truth itself"
            raise InputError(f"prior.options.of: expected a prior whose errors can be corrected, found {of}: {reason}")
        self._share = share
        self.provides = self._prior.provides
        self.stochastic = self._prior.stochastic
        self.guidable = self._prior.guidable
        self.resolution = self._prior.resolution
        self.encoding: Mapping[str, str] = self._prior.encoding
        self._truth = RevealedTruth("corrected")

    @property
    def network_calls(self) -> int:
        """Of the prior that is corrected."""
        return self._prior.network_calls

    @property
    def counters(self) -> Mapping[str, int]:
        """Of the prior that is corrected."""
        return self._prior.counters if isinstance(self._prior, Counted) else {}

    @property
    def patches(self) -> bool | str | None:
        """Of the prior that is corrected; None where it predicts no patches."""
        return self._prior.patches if isinstance(self._prior, Patchwise) else None

    def use_patches(self, patches: bool) -> None:
        """See :class:`ia_bench.priors.contract.Patchwise`."""
        if isinstance(self._prior, Patchwise):
            self._prior.use_patches(patches)

    @property
    def reads_geometry(self) -> bool:
        """Whether the prior that is corrected does."""
        return isinstance(self._prior, GeometryReader) and self._prior.reads_geometry

    def give_geometry(self, normals: Tensor, visibility: Tensor) -> None:
        """See :class:`ia_bench.priors.contract.GeometryReader`."""
        if isinstance(self._prior, GeometryReader):
            self._prior.give_geometry(normals, visibility)

    def reveal(self, views: tuple[View, ...]) -> None:
        """Receive the training views with ground truth. Raises InputError when a view lacks a component."""
        self._truth.reveal(views, self.provides)

    def sample(
        self, images: Tensor, masks: Tensor, *, seed: int, guidance: Mapping[str, Tensor] | None = None
    ) -> dict[str, Tensor]:
        """See :meth:`ia_bench.priors.contract.Prior.sample`; images must be the revealed training views, in order."""
        for component in self.provides:
            self._truth.check(component, tuple(images.shape))
        samples = self._prior.sample(images, masks, seed=seed, guidance=guidance)
        truths = {name: torch.from_numpy(self._truth[name]).to(sample) for name, sample in samples.items()}
        return {name: torch.lerp(truths[name], sample, self._share) for name, sample in samples.items()}
