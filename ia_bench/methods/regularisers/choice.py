"""The regularisers that ``fit.regularise`` names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ia_bench.common import registry
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.settings import arguments_for

if TYPE_CHECKING:
    from ia_bench.methods.contract import Regulariser

OPTIONS = "fit.regulariser_options"


def options_for(names: Sequence[str], options: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """``options`` as they take them. Raises InputError unless all ``names`` are regularisers', each once, and these their options.

    Nor may ``context`` come after ``symmetry``: it fills anew what no photograph shows. ``module:Class`` has the options of Class.
    """
    if len(set(names)) < len(names):
        raise InputError(f"fit.regularise: expected each name once, found {', '.join(names)}")
    keys, found = {name: name.rpartition(":")[2] for name in names}, dict[str, dict[str, Any]]()
    for key in options:
        if key not in keys.values():
            raise InputError(unknown("regulariser in", key, [*keys.values()], prefix=f"{OPTIONS}."))
    for name, key in keys.items():
        kind = registry.load(registry.find("regulariser", name))
        given = arguments_for(kind, options.get(key, {}), f"{OPTIONS}.{key}")
        found |= {key: given} if key in options else {}
    if [name for name in names if name in ("context", "symmetry")] == ["symmetry", "context"]:
        listed = ", ".join(names)
        raise InputError(f"fit.regularise: expected context before symmetry, whose guesses it would overwrite, found {listed}")
    return found


def regularisers_of(names: Sequence[str], options: Mapping[str, Mapping[str, Any]]) -> list[Regulariser]:
    """They themselves, made for one fit; those of other distributions are checked at work."""
    from ia_bench.methods.validation import checked_part  # brings in torch

    found = [(registry.find("regulariser", name), options.get(name.rpartition(":")[2], {})) for name in names]
    made = [(plugin.name, registry.create("regulariser", plugin.name, plugin.target, given)) for plugin, given in found]
    return [checked_part("regulariser", name, one) for name, one in made]
