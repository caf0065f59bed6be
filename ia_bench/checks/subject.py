"""The prior that is checked, and how it is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.checks.stack import Stack
from ia_bench.priors.contract import Distiller, Observations, Prior, Refiner, Samples

GEOMETRY = frozenset({"normals", "visibility", "view_count"})
"""What a prior may want of a scene, and must do without."""

Images = dict[str, Tensor]


class Subject:
    """The prior under test, and how to ask it: copies of the inputs, other global random states, what it cost."""

    def __init__(self, make: Callable[[], Prior], prior: Prior, stack: Stack) -> None:
        self.make, self.prior, self.stack = make, prior, stack
        self.info, self.components = prior.info, sorted(prior.info.provides)
        self.modified: set[str] = set()
        self.geometry = False  # whether a prior that wants geometry is shown it
        self.costs: list[Mapping[str, int]] = []
        self._asked = 0
        self._base: Samples | None = None

    def ask(self, stack: Stack, *, seed: int = 0, guidance: Images | None = None, prior: Prior | None = None) -> Samples:
        """One sample of the prior under test, or of another instance of it."""
        return self.ask_about(self.shown(stack), seed=seed, guidance=guidance, prior=prior)

    def ask_about(
        self, shown: Observations, *, seed: int = 0, guidance: Images | None = None, prior: Prior | None = None
    ) -> Samples:
        """The same of observations that need be of no stack."""
        asked = self.prior if prior is None else prior
        return self._watched(shown, "guidance", guidance, lambda: asked.sample(shown, seed=seed, guidance=guidance))

    def shown(self, stack: Stack) -> Observations:
        """What a run would show the prior of these views."""
        return stack.shown(self.info.wants if self.geometry else self.info.wants - GEOMETRY)

    def distill(self, stack: Stack, renders: Images, seed: int) -> Samples:
        """Estimates of ``renders`` by the prior under test."""
        shown, prior = self.shown(stack), self.prior
        assert isinstance(prior, Distiller)
        return self._watched(shown, "renders", renders, lambda: prior.distill(shown, renders, seed=seed))

    def refine(self, stack: Stack, renders: Images) -> Samples:
        """The albedo of ``renders`` as the prior under test corrects it, which sees the geometry that it wants."""
        shown, prior = stack.shown(self.info.wants), self.prior
        assert isinstance(prior, Refiner)
        return self._watched(shown, "renders", renders, lambda: prior.refine(shown, renders))

    def _watched(self, shown: Observations, what: str, renders: Images | None, call: Callable[[], Samples]) -> Samples:
        """What ``call`` returns; remembers which of its inputs it wrote to, and what it cost."""
        inputs = {name: value for name, value in vars(shown).items() if isinstance(value, Tensor)}
        inputs |= {f"true {name}": value for name, value in (shown.truth or {}).items()}
        inputs |= {f"{what} {name}": value for name, value in (renders or {}).items()}
        kept = {name: value.clone() for name, value in inputs.items()}
        self._asked += 1  # another state of the global generators each time: a sample must not depend on them
        torch.manual_seed(self._asked)
        np.random.seed(self._asked)
        samples = call()
        self.modified |= {n for n, v in inputs.items() if not torch.equal(v.nan_to_num(), kept[n].nan_to_num())}
        if isinstance(samples, Samples) and isinstance(samples.values, Mapping):
            self.costs.append(samples.cost)
            copies = {name: value.clone() if isinstance(value, Tensor) else value for name, value in samples.values.items()}
            samples = replace(samples, values=copies)  # because the prior may write to what it has handed out
        return samples

    @property
    def base(self) -> Samples:
        """The unguided sample of the stack for seed 0."""
        if self._base is None:
            self._base = self.ask(self.stack)
        return self._base
