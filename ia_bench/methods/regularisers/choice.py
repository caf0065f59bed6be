"""The regularisers that ``fit.regularise`` names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ia_bench.common import registry
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.settings import check_arguments

if TYPE_CHECKING:
    from ia_bench.methods.contract import Regulariser

OPTIONS = "fit.regulariser_options"


def check_regularisers(names: Sequence[str], options: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise InputError unless all ``names`` are those of regularisers, each once, and the ``options`` are theirs.

    Nor may ``context`` come after ``symmetry``: it fills anew what no photograph shows. ``module:Class`` has the options of Class.
    """
    if len(set(names)) < len(names):
        raise InputError(f"fit.regularise: expected each name once, found {', '.join(names)}")
    keys = {name: name.rpartition(":")[2] for name in names}
    for key in options:
        if key not in keys.values():
            raise InputError(unknown("regulariser in", key, [*keys.values()], prefix=f"{OPTIONS}."))
    for name, key in keys.items():
        kind = registry.load(registry.find("regulariser", name))
        check_arguments(kind, options.get(key, {}), f"{OPTIONS}.{key}")
    if [name for name in names if name in ("context", "symmetry")] == ["symmetry", "context"]:
        found = ", ".join(names)
        raise InputError(f"fit.regularise: expected context before symmetry, whose guesses it would overwrite, found {found}")


def regularisers_of(names: Sequence[str], options: Mapping[str, Mapping[str, Any]]) -> list[Regulariser]:
    """They themselves, made for one fit; those of other distributions are checked at work."""
    from ia_bench.methods.validation import checked_part  # brings in torch

    found = [(registry.find("regulariser", name), options.get(name.rpartition(":")[2], {})) for name in names]
    made = [(plugin.name, registry.create("regulariser", plugin.name, plugin.target, given)) for plugin, given in found]
    return [checked_part("regulariser", name, one) for name, one in made]
