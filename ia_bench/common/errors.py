"""The exceptions that the command line shows as a plain message instead of a traceback, and what they say of others."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path


class InputError(ValueError):
    """Something the user gave is wrong: the message names the file or key, what was expected and what was found."""


class PluginError(InputError):
    """A plugin raises, or gives back what its contract does not allow; the message names it. A command ends with status 1."""


class Fault(RuntimeError):
    """What was asked for is right and yet cannot be done: a full disk, a dead worker. The message is one sentence."""


def printable(text: str) -> str:
    """``text`` with an escape for every character that no terminal prints, line breaks and lone surrogates among them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def first_line(error: BaseException) -> str:
    """The first line of an error that may have many; its kind where it says nothing."""
    try:
        lines = str(error).splitlines()
    except Exception:  # of an exception that cannot say what it is
        lines = []
    return next((printable(line.strip()) for line in lines if line.strip()), type(error).__name__)


def place_of(error: BaseException) -> str:
    """The file and line that an exception came from, "my_prior.py:28"; empty where it has no traceback."""
    places = traceback.extract_tb(error.__traceback__, limit=-1)
    return f"{Path(places[0].filename).name}:{places[0].lineno}" if places else ""


def raised(error: BaseException) -> str:
    """The kind of an exception and the first line of what it says."""
    kind, said = type(error).__name__, first_line(error)
    return f"{kind}: {'no message' if said == kind else said}"


def unknown(what: str, name: str, known: Iterable[str], prefix: str = "") -> str:
    """One sentence naming what is unknown, the closest known name if one is near, and all known names.

    ``prefix`` is put before the names without taking part in the comparison.

    >>> unknown("preset", "quik", ["full", "quick"])
    "unknown preset 'quik'; did you mean 'quick'? There are: full, quick"
    """
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"; did you mean '{prefix}{near[0]}'?" if near else "."
    return f"unknown {what} '{prefix}{name:.200}'{hint} There {'are' if names else 'is'}: {listed(names)}"


def listed(names: Iterable[str]) -> str:
    """Names with commas between; those with one in them stand in quotes. "none of them" for no name.

    >>> listed(["none", "refiner, hull"])
    "none, 'refiner, hull'"
    """
    return ", ".join(f"'{name}'" if "," in name else name for name in names) or "none of them"


def expect_distinct(what: str, names: Sequence[str]) -> None:
    """Raise InputError, saying ``what`` was expected, where two of the ``names`` are the same."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{what}, found {names.count(twice)} called {twice}")
