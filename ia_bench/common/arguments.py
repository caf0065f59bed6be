"""Values of command lines: KEY=VALUE arguments as a dataclass, and numbers that argparse refuses with the option's name."""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import UnionType
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed

T = TypeVar("T")
NULL = "null", "~"  # as YAML writes it


def read_arguments(kind: type[T], arguments: Sequence[str]) -> T:
    """KEY=VALUE arguments as the dataclass ``kind``; keys of a dataclass inside it are dotted.

    Values are YAML, which has lists, tables and null; texts and paths are taken as they are, and tuples with commas between.
    Raises InputError naming the key that is unknown, missing, has no value, or has one that its annotation does not take.
    """
    content: dict[str, Any] = {}
    for argument in arguments:
        key, separator, text = argument.partition("=")
        *above, last = key.split(".")
        table, hints = content, get_type_hints(kind)
        for part in above:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise InputError(f"{key}: expected a setting, found one below {part}, which is {table!r}")
            hints = get_type_hints(hints[part]) if dataclasses.is_dataclass(hints.get(part)) else {}
        if not separator or not text:
            raise InputError(f"{key}: expected {key}=VALUE, found '{argument}'")
        table[last] = _meant(text, hints.get(last))
    return parsed(kind, content)


def _meant(text: str, hint: object) -> object:
    """What ``text`` means as a value of a field of that type."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    items = next((get_args(kind) for kind in kinds if get_origin(kind) is tuple), None)
    if items and not text.startswith("["):
        return [part if str in items else value_of(part) for part in text.split(",")]
    if Path in kinds and text not in NULL:
        return str(Path(text).expanduser())
    return text if str in kinds and text not in NULL else value_of(text)


def settings_of(kind: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:  # noqa: ANN401 (a dataclass)
    """The keys of :func:`read_arguments` with their defaults, ``dataclasses.MISSING`` where there is none."""
    for item in dataclasses.fields(kind):
        made = item.default if item.default_factory is dataclasses.MISSING else item.default_factory()
        inside = dataclasses.is_dataclass(made)
        yield from settings_of(made, f"{prefix}{item.name}.") if inside else [(prefix + item.name, made)]


def settings_text(kind: type[object]) -> str:
    """The keys of :func:`read_arguments` and their defaults, one a line, as a command's help ends with them."""
    return "\n".join(f"  {key:<28}{'(required)' if value is dataclasses.MISSING else value}" for key, value in settings_of(kind))


class Parser(argparse.ArgumentParser):
    """A parser of options that takes no beginnings of names for them and says a mistake in one sentence, as an InputError."""

    def __init__(self, *given: Any, **settings: Any) -> None:  # noqa: ANN401 (argparse's own)
        settings["allow_abbrev"] = False
        super().__init__(*given, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise it, with the way to the help."""
        said = message.removeprefix("argument ").replace("the following arguments are required: ", "expected ")
        raise InputError(f"{said}; {self.prog} --help says more")


def at_least(least: int) -> Callable[[str], int]:
    """An argparse ``type``: a whole number that is not below ``least``."""

    def number(text: str) -> int:
        if not re.fullmatch(r"-?[0-9]{1,18}", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, found {text}")
        return int(text)

    return number


def number_of(expected: str, holds: Callable[[float], bool]) -> Callable[[str], float]:
    """An argparse ``type``: a number of which ``holds`` is true; ``expected`` says in words what that asks."""

    def number(text: str) -> float:
        with suppress(ValueError):
            if holds(float(text)):
                return float(text)
        raise argparse.ArgumentTypeError(f"expected {expected}, found {text}")

    return number


def value_of(text: str) -> object:
    """``text`` as YAML reads it, and 5e-4 as a number."""
    try:
        value = yaml.safe_load(text)
        if isinstance(value, str):
            return float(value) if value.isascii() else text  # float() reads digits of every script
        return value
    except (yaml.YAMLError, ValueError):  # also of a date that does not exist
        return text
