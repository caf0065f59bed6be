"""Values of command lines: KEY=VALUE arguments as a dataclass, and numbers that argparse refuses with the option's name."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints

import yaml

from ia_bench.common.errors import InputError
from ia_bench.common.suggestions import unknown
from ia_bench.common.typed import fits, named

T = TypeVar("T")


def read_arguments(kind: type[T], arguments: Sequence[str], command: str) -> T:
    """The dataclass ``kind`` from KEY=VALUE ``arguments`` of ``command``; keys of a dataclass inside it are dotted.

    Raises InputError naming the key that is unknown, missing, has no value, or has one that its annotation does not take.
    """
    known = dict(_keys(kind))
    values: dict[str, Any] = {}
    for argument in arguments:
        key, separator, text = argument.partition("=")
        if key not in known:
            raise InputError(unknown(f"setting of {command}", key, known))
        if not separator or not text:
            raise InputError(f"{key}: expected {key}=VALUE, found '{argument}'")
        values[key] = _value(key, text, known[key])
    return _build(kind, values)


def settings_of(kind: type, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The keys of :func:`read_arguments` with their defaults, ``dataclasses.MISSING`` where there is none."""
    for key, default, part in _fields(kind, prefix):
        yield from settings_of(part, f"{key}.") if part else [(key, default)]


def at_least(least: int) -> Callable[[str], int]:
    """An argparse ``type``: a whole number that is not below ``least``."""

    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = None
        if value is None or value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, found {text}")
        return value

    return number


def _fields(kind: Any, prefix: str) -> Iterator[tuple[str, Any, type | None]]:  # noqa: ANN401 (a dataclass)
    """Dotted name and default of each field, and the dataclass that it is, if it is one."""
    hints = get_type_hints(kind)
    for item in dataclasses.fields(kind):
        made = item.default_factory is not dataclasses.MISSING
        part = hints[item.name] if dataclasses.is_dataclass(hints[item.name]) else None
        yield prefix + item.name, item.default_factory() if made and not part else item.default, part  # type: ignore[operator]


def _keys(kind: type, prefix: str = "") -> Iterator[tuple[str, Any]]:
    hints = get_type_hints(kind)
    for key, _, part in _fields(kind, prefix):
        yield from _keys(part, f"{key}.") if part else [(key, hints[key.removeprefix(prefix)])]


def _build(kind: type[T], values: Mapping[str, Any], prefix: str = "") -> T:
    given: dict[str, Any] = {}
    for key, default, part in _fields(kind, prefix):
        if part:
            given[key.removeprefix(prefix)] = _build(part, values, f"{key}.")
        elif key in values:
            given[key.removeprefix(prefix)] = values[key]
        elif default is dataclasses.MISSING:
            raise InputError(f"expected {key}=VALUE; --help says more")
    return kind(**given)


def _value(key: str, text: str, kind: Any) -> Any:  # noqa: ANN401 (any field's type and value)
    """``text`` as YAML reads it, if it fits ``kind``; texts and paths are taken as they are."""
    kinds = get_args(kind) or (kind,)
    if NoneType in kinds and text in ("null", "~"):
        return None
    if Path in kinds or str in kinds:
        return Path(text).expanduser() if Path in kinds else text
    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError):  # of a date that does not exist
        value = text  # which fits nothing but text
    if float in kinds and isinstance(value, int | str) and not isinstance(value, bool):
        try:
            value = float(value)  # YAML 1.1 reads 5e-4 as text
        except (OverflowError, ValueError):
            value = text
    choices = [choice for choice in kinds if isinstance(choice, str)]
    if choices and value not in choices:
        raise InputError(unknown(f"value of {key}", text, choices))
    if not fits(value, kind):
        raise InputError(f"{key}: expected {named(kind)}, found {text!r}")
    return tuple(value) if isinstance(value, list) else value
