"""The first half of a prior's contract: the members that it declares, without calling any of them."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from ia_bench.checks.finding import Finding, judge
from ia_bench.priors.contract import PriorInfo


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
