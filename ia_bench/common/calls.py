"""What is given to a call from Python, where no configuration checks it; a mistake is one sentence that names the argument."""

from __future__ import annotations

from numbers import Integral
from pathlib import Path
from types import UnionType

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown

LONGEST_PART = 255  # characters between the slashes of a path; file systems take no more


def expect_kind(kind: type | UnionType, words: str, **given: object) -> None:
    """Raise InputError, saying in ``words`` what was expected, for one that is not of the ``kind``."""
    for name, value in given.items():
        if not isinstance(value, kind):
            raise InputError(f"{name}: expected {words}, found {type(value).__name__}")


def expect_whole(least: int, **given: object) -> None:
    """Raise InputError for one that is no whole number of at least ``least``."""
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
            raise InputError(f"{name}: expected a whole number of at least {least}, found {shown(repr(value))}")


def path_of(name: str, value: object) -> Path:
    """The path that is given, from the home folder on where it begins with ~. Raises InputError for what no path can be."""
    expect_kind(str | Path, "a path", **{name: value})
    path = Path(text := str(value))
    if not text or "\0" in text or any(len(part) > LONGEST_PART for part in path.parts):
        raise InputError(f"{name}: expected a path, found {shown(repr(text))}")
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise InputError(f"{name}={shown(path)}: expected a path, found one without a home folder ({error})") from None
