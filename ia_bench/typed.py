"""Values of YAML and JSON against the type annotations of what they are given to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

NAMES: dict[type, str] = {int: "a whole number", float: "a number", bool: "true or false", str: "text", NoneType: "null"}


def fits(value: Any, kind: Any) -> bool:  # noqa: ANN401 (any value and annotation)
    """Whether ``value`` may be given where ``kind`` is annotated; a whole number is a number, and a list is any sequence.

    An annotation other than a scalar, a choice, or a list or table of them fits everything: nothing is known of its values.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(fits(value, part) for part in parts)
    if origin is Literal:
        return any(value == part and type(value) is type(part) for part in parts)
    if _is_list(kind):
        return isinstance(value, list | tuple) and all(fits(item, part) for item in value for part in parts[:1])
    if origin in (dict, Mapping):
        return isinstance(value, Mapping)
    if not isinstance(kind, type) or kind not in NAMES:
        return True
    if isinstance(value, bool):  # which Python counts among the whole numbers
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def named(kind: Any) -> str:  # noqa: ANN401 (any annotation)
    """What ``kind`` expects, as a message says it."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(named(part) for part in parts)
    if origin is Literal:
        return " or ".join(map(str, parts))
    if _is_list(kind):
        return "a list" + "".join(f" ({named(part)} each)" for part in parts[:1])
    if origin in (dict, Mapping):
        return "a table"
    return NAMES.get(kind, str(kind))


def _is_list(kind: Any) -> bool:  # noqa: ANN401 (any annotation)
    origin, parts = get_origin(kind), get_args(kind)
    return origin in (list, Iterable, Sequence) or (origin is tuple and parts[1:] == (...,))
