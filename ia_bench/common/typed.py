"""Values of YAML and JSON against the types and ranges of what they are given to."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from ia_bench.common.errors import InputError

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


def check_ranges(settings: object, ranges: Mapping[str, tuple[float, float]], prefix: str = "") -> None:
    """Raise InputError for the first of ``settings``' numbers that is not finite, or beyond its least or largest value.

    Keys of ``ranges`` are attributes, dotted inside parts; the message puts ``prefix`` before them. None is in every range.
    """
    for key, (least, most) in ranges.items():
        value = attrgetter(key)(settings)
        if value is not None and not (math.isfinite(value) and least <= value <= most):
            expected = f"from {least:.10g} to {most:.10g}" if most < math.inf else f">= {least:.10g}"
            raise InputError(f"{prefix}{key}: expected a finite number {expected}, found {value}")


def _is_list(kind: Any) -> bool:  # noqa: ANN401 (any annotation)
    origin, parts = get_origin(kind), get_args(kind)
    return origin in (list, Iterable, Sequence) or (origin is tuple and parts[1:] == (...,))
