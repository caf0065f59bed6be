"""Messages for a name that does not exist: the closest one that does, and the list of all."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown(what: str, name: str, known: Iterable[str], prefix: str = "") -> str:
    """One sentence naming what is unknown, the closest known name if one is near, and all known names.

    ``prefix`` is put before the names without taking part in the comparison.

    >>> unknown("preset", "quik", ["full", "quick"])
    "unknown preset 'quik'; did you mean 'quick'? There are: full, quick"
    """
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"; did you mean '{prefix}{near[0]}'?" if near else "."
    return f"unknown {what} '{prefix}{name}'{hint} There {'are' if names else 'is'}: {listed(names)}"


def listed(names: Iterable[str]) -> str:
    """Names with commas between; those with one in them stand in quotes. "none of them" for no name.

    >>> listed(["none", "refiner, hull"])
    "none, 'refiner, hull'"
    """
    return ", ".join(f"'{name}'" if "," in name else name for name in names) or "none of them"
