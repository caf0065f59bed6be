"""Which coupling a run uses, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ia_bench.common import registry
from ia_bench.common.errors import PluginError
from ia_bench.methods.contract import Coupling, NoCoupling
from ia_bench.methods.info import AUTO
from ia_bench.methods.validation import checked_coupling
from ia_bench.priors.contract import PriorInfo

DEFAULT = "kernel"
"""What a prior is coupled by that recommends nothing, built in or not."""


def coupling_of(
    info: PriorInfo, name: str, target: str | None, options: Mapping[str, Any], note: Callable[[str], None]
) -> Coupling:
    """The coupling called ``name``; "auto" is what the prior's ``info`` recommends, or the DEFAULT. Which it is, is told.

    Raises InputError for one that is not there or cannot be made, PluginError where a prior recommends none that is there.
    """
    if not info.provides:
        return NoCoupling()  # of nothing
    why = "as it was set"
    if name == AUTO:
        name, why = (info.coupling, "which the prior recommends") if info.coupling else (DEFAULT, "the default")
        target = None
        if info.coupling and name not in {**registry.built_in("coupling"), **registry.installed("coupling")}:
            raise PluginError(f"the prior recommends coupling {name!r}, expected the name of one that is installed, found none")
    made = registry.create("coupling", name, target or registry.find("coupling", name).target, options)
    coupling = checked_coupling(name, made)
    used = ", ".join(sorted(coupling.uses(info.provides))) or "nothing"
    note(f"coupling: {name}, {why}; it uses {used} of the prior's {', '.join(sorted(info.provides))}")
    return coupling
