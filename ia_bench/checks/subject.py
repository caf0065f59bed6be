"""The prior that is checked: which members it declares, and how it is asked."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.modules.module import register_module_forward_pre_hook

from ia_bench.checks.finding import Finding, judge
from ia_bench.checks.stack import Stack
from ia_bench.priors.contract import Distiller, Observations, Prior, PriorInfo, Refiner, Samples

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
        self.forwards = 0  # of networks, while it was asked
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
        counting = register_module_forward_pre_hook(lambda module, inputs: self._count())
        try:
            samples = call()
        finally:
            counting.remove()
        self.modified |= {n for n, v in inputs.items() if not torch.equal(v.nan_to_num(), kept[n].nan_to_num())}
        if isinstance(samples, Samples) and isinstance(samples.values, Mapping):
            self.costs.append(samples.cost)
            copies = {name: value.clone() if isinstance(value, Tensor) else value for name, value in samples.values.items()}
            samples = replace(samples, values=copies)  # because the prior may write to what it has handed out
        return samples

    def _count(self) -> None:
        self.forwards += 1

    @property
    def base(self) -> Samples:
        """The unguided sample of the stack for seed 0."""
        if self._base is None:
            self._base = self.ask(self.stack)
        return self._base


def check_members(prior: Any) -> Iterator[Finding]:  # noqa: ANN401 (anything may claim to be a prior)
    """One finding per member of :class:`ia_bench.priors.contract.Prior`, and per optional one that is there."""
    info = getattr(prior, "info", None)
    found = repr(info)
    if isinstance(info, PriorInfo):  # its sets in one order whatever the hash seed is
        found = ", ".join(f"{name} {sorted(v) if isinstance(v, frozenset) else v}" for name, v in vars(info).items())
    yield judge(isinstance(info, PriorInfo), "info", "an ia_bench.priors.contract.PriorInfo", found[:300])
    signature = "sample(observations, *, seed, guidance=None)"
    yield _callable(prior, "sample", signature, ("observations",), {"seed": 0, "guidance": None})
    if hasattr(prior, "distill"):
        yield _callable(prior, "distill", "distill(observations, renders, *, seed)", ("observations", "renders"), {"seed": 0})
    if hasattr(prior, "refine"):
        yield _callable(prior, "refine", "refine(observations, renders)", ("observations", "renders"), {})
    if hasattr(prior, "fingerprint"):
        value = prior.fingerprint
        yield judge(isinstance(value, str) and bool(value), "fingerprint", "a text", f"{value!r:.300}")


def _callable(prior: Any, name: str, expected: str, positional: tuple[str, ...], named: dict[str, Any]) -> Finding:  # noqa: ANN401
    method = getattr(prior, name, None)
    if not callable(method):
        return Finding("fail", name, expected, "no such method")
    signature = inspect.signature(method)
    bare = [parameter.replace(annotation=inspect.Parameter.empty) for parameter in signature.parameters.values()]
    found = f"{name}{inspect.Signature(bare)}"
    try:
        signature.bind(*positional, **named)
    except TypeError as error:
        return Finding("fail", name, expected, f"{found}: {error}")
    return Finding("pass", name, expected, found)
