"""The first half of a prior's contract: the members that it declares, and their types."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ia_bench.checks.finding import Finding, judge
from ia_bench.priors.contract import COMPONENTS

ENCODINGS = ("linear", "srgb")


def check_members(prior: Any) -> Iterator[Finding]:  # noqa: ANN401 (anything may claim to be a prior)
    """One finding per member of :class:`ia_bench.priors.contract.Prior`, without calling any of them."""
    expectations: dict[str, tuple[str, Callable[[Any], bool]]] = {
        "provides": (f"a frozenset of some of {', '.join(COMPONENTS)}", _is_subset),
        "stochastic": ("True or False", lambda value: isinstance(value, bool)),
        "guidable": ("True or False", lambda value: isinstance(value, bool)),
        "resolution": ("a number of pixels > 0, or None", lambda value: value is None or (is_int(value) and value > 0)),
        "encoding": (f"a mapping of every component provided to one of {', '.join(ENCODINGS)}", _is_encoding(prior)),
        "sees_truth": ("True or False", lambda value: isinstance(value, bool)),
        "network_calls": ("an int >= 0", lambda value: is_int(value) and value >= 0),
    }
    for name, (expected, holds) in expectations.items():
        if not hasattr(prior, name):
            yield Finding("fail", name, expected, "no such member")
        else:
            value = getattr(prior, name)
            yield judge(holds(value), name, expected, _shown(value))
    signature = "sample(images, masks, *, seed, guidance=None)"
    yield _callable(prior, "sample", signature, ("images", "masks"), {"seed": 0, "guidance": None})
    if getattr(prior, "sees_truth", False) is True:
        yield _callable(prior, "reveal", "reveal(views), because it declares sees_truth", ("views",), {})
    yield from _optional_members(prior)


def _optional_members(prior: Any) -> Iterator[Finding]:  # noqa: ANN401 (anything may claim to be a prior)
    """Members of the contract that a prior may leave out, and must have right where it does not."""
    if hasattr(prior, "distill"):
        signature = "distill(images, masks, renders, *, seed)"
        yield _callable(prior, "distill", signature, ("images", "masks", "renders"), {"seed": 0})
    if hasattr(prior, "reads_geometry"):
        value = prior.reads_geometry
        yield judge(isinstance(value, bool), "reads_geometry", "True or False", _shown(value))
        signature = "give_geometry(normals, visibility), because it declares reads_geometry"
        yield _callable(prior, "give_geometry", signature, ("normals", "visibility"), {})
    if hasattr(prior, "ceilings"):
        yield _callable(prior, "ceilings", "ceilings(images, masks)", ("images", "masks"), {})
    if hasattr(prior, "use_patches"):
        value = getattr(prior, "patches", None)
        expected = "True, False or auto, because it declares use_patches"
        yield judge(value in (True, False, "auto"), "patches", expected, _shown(value))
        yield _callable(prior, "use_patches", "use_patches(patches)", ("patches",), {})
    if hasattr(prior, "fingerprint"):
        value = prior.fingerprint
        yield judge(isinstance(value, str) and bool(value), "fingerprint", "a text", _shown(value))


def is_int(value: Any) -> bool:  # noqa: ANN401 (a member of any type)
    """Whether it is an int, which True and False are not here."""
    return isinstance(value, int) and not isinstance(value, bool)


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


def _is_subset(value: Any) -> bool:  # noqa: ANN401 (a member of any type)
    return isinstance(value, frozenset) and value <= set(COMPONENTS)


def _is_encoding(prior: Any) -> Callable[[Any], bool]:  # noqa: ANN401 (anything may claim to be a prior)
    provided = getattr(prior, "provides", ())
    return lambda value: isinstance(value, Mapping) and all(value.get(name) in ENCODINGS for name in provided)


def _shown(value: Any) -> str:  # noqa: ANN401 (a member of any type)
    if isinstance(value, frozenset):  # in one order whatever the hash seed is
        return f"frozenset of {', '.join(sorted(map(str, value))) or 'nothing'}"
    return f"{value!r} ({type(value).__name__})"
