"""Settings from files and command lines, checked against dataclasses by pydantic; a mistake is one sentence that names the key."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError
from pydantic_core import ErrorDetails

from ia_bench.common.errors import InputError, PluginError, unknown

T = TypeVar("T")

EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number of a few digits",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "text",
    "none_required": "null",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "dataclass_type": "a table",
    "missing": "a value",
    "dataclass_exact_type": "a {class_name}",
    "string_too_short": "some text",
    "greater_than_equal": "{ge:.10g} or more",
    "greater_than": "more than {gt:.10g}",
    "less_than_equal": "{le:.10g} or less",
    "less_than": "less than {lt}",
    "literal_error": "{expected}",
    "too_short": "at least one",
}
"""What a kind of pydantic's errors expects, in the words of a message."""

UNKNOWN = {"unexpected_keyword_argument", "extra_forbidden"}
"""Kinds of pydantic's errors about a name that is no setting."""

FINITE = ConfigDict(allow_inf_nan=False)
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)


def parsed(kind: type[T], content: Mapping[str, Any], key: str = "") -> T:
    """``content``, JSON types, as the dataclass ``kind``; numbers are no texts, whole numbers are numbers.

    Raises InputError for the first value that its field does not take, and for a name that is no field, with the closest one;
    ``key`` is put before the names.
    """
    return _checked(_adapter(kind), kind, content, key)  # type: ignore[arg-type]  # to mypy no generic class is hashable


@functools.cache  # a table asks for the same ones in every cell, and making one takes milliseconds
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(_forbidding(kind))


def parsed_file(kind: type[T], path: Path, content: Mapping[str, Any], said: str = "", advice: str = "") -> T:
    """:func:`parsed` of what a file holds: its name, and what is ``said`` of it, stand before what is wrong, ``advice`` after."""
    try:
        return parsed(kind, content)
    except InputError as error:
        raise InputError(f"{path}: {said}{error}{advice}") from None


def check_fields(instance: object, who: str) -> None:
    """Raise PluginError, ``who`` before the field's name, for a dataclass of a plug-in's with a value of another type."""
    for name, hint in get_type_hints(type(instance), include_extras=True).items():
        try:
            TypeAdapter(hint, config=FINITE).validate_python(value := getattr(instance, name), strict=True)
        except ValidationError as error:
            expected = " or ".join(map(_words, error.errors(include_url=False)))
            raise PluginError(f"{who}{name}: expected {expected}, found {value!r:.100}") from None


def arguments_for(factory: Callable[..., Any], options: Mapping[str, Any], key: str, given: int = 0) -> dict[str, Any]:
    """``options`` as the keyword parameters of ``factory`` after the ``given`` ones take them: a 1 is 1.0 where that is a float.

    Raises InputError like :func:`parsed` where they do not fit; parameters without an annotation that can be told take everything.
    """
    fields, adapter = _fields_of(factory, given)
    if adapter is None:
        return dict(options)
    missing = [name for name, (_, default) in fields.items() if default is ... and name not in options]
    if missing and options.keys() <= fields.keys():  # a name that is none is likely to be meant for the one that is missing
        raise InputError(f"{key}: expected {', '.join(f'{key}.{name}=...' for name in missing)}, found none")
    made = adapter.dump_python(_checked(adapter, fields, options, key), mode="json", warnings=False)
    return {name: made[name] for name in options}


@functools.cache
def _fields_of(factory: Callable[..., Any], given: int) -> tuple[dict[str, Any], TypeAdapter[Any] | None]:
    """Type and default of each parameter of :func:`arguments_for`, and what checks them; None where everything is taken."""
    parameters = list(inspect.signature(factory).parameters.values())[given:]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return {}, None
    hints: dict[str, Any] = {}
    # Texts among a dataclass's annotations are of the file of each base, those of an __init__ of its own of its file.
    for annotated in (factory, factory.__init__) if isinstance(factory, type) else (factory,):  # type: ignore[misc]
        with suppress(Exception):  # foreign annotations may name what only a type checker imports
            hints |= get_type_hints(annotated, include_extras=True)
    fields: dict[str, Any] = {}
    for p in parameters:
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY):
            hint = hints.get(p.name, Any)
            if get_origin(hint) is Iterable:
                hint = list[get_args(hint)[0]]  # type: ignore[misc]  # a type that is only known now
            try:
                TypeAdapter(hint).json_schema()
            except (PydanticUserError, TypeError):  # no type of JSON
                hint = Any
            optional = hint | None if p.default is None and hint is not Any else hint  # which annotations often leave out
            fields[p.name] = (optional, ... if p.default is p.empty else p.default)
    parts = [(name, kind, None) for name, (kind, _) in fields.items()]  # arguments_for asks for what has to be given
    made = dataclasses.make_dataclass("Options", parts, namespace={"__pydantic_config__": STRICT})  # models keep some names
    return fields, TypeAdapter(made)


def defaults_of(factory: Callable[..., Any], given: int = 0) -> dict[str, Any]:
    """The defaults of the parameters of ``factory`` after the ``given`` ones, by their names."""
    parameters = list(inspect.signature(factory).parameters.values())[given:]
    return {p.name: p.default for p in parameters if p.default is not p.empty}


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """``below`` with what ``above`` says instead, tables within tables likewise."""
    both = dict(below)
    for key, value in above.items():
        under = both.get(key)
        both[key] = merged(under, value) if isinstance(under, Mapping) and isinstance(value, Mapping) else value
    return both


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one with dotted names; an empty one stays as it is."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        name = f"{prefix}{key}"
        found |= flat(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value}
    return found


def _checked(adapter: TypeAdapter[T], known: Any, content: Mapping[str, Any], key: str) -> T:  # noqa: ANN401 (a class or names)
    try:
        text = json.dumps(content, default=repr)  # of another type, which the check below refuses by its key
    except (TypeError, ValueError) as error:
        raise InputError(f"{key}: expected numbers, texts, lists and tables, found {error}") from None
    _expect_writable(content, key)
    try:
        return adapter.validate_json(text, strict=True)
    except ValidationError as error:
        for one in error.errors():
            if isinstance(cause := one.get("ctx", {}).get("error"), InputError):  # of a class that checks itself
                raise cause from None
        raise InputError(_sentence(error.errors(include_url=False), known, content, key)) from None


def _expect_writable(content: Any, key: str) -> None:  # noqa: ANN401 (JSON)
    """Raise InputError, naming the key, for what JSON has not: NaN, infinity, text of no encoding, and types such as dates."""
    if isinstance(content, Mapping):
        for name, part in content.items():
            _expect_writable(part, f"{key}.{name}" if key else str(name))
    elif isinstance(content, list | tuple):
        for place, part in enumerate(content):
            _expect_writable(part, f"{key}[{place}]")
    elif isinstance(content, float) and not math.isfinite(content):
        raise InputError(f"{key}: expected a finite number, found {content}")
    elif isinstance(content, str) and not content.isascii() and any("\ud800" <= letter <= "\udfff" for letter in content):
        raise InputError(f"{key}: expected text, found {content!r:.100}, which is none in UTF-8")
    elif not isinstance(content, str | int | float | None):
        found = f"the {type(content).__name__} {content!s:.100}"
        raise InputError(f"{key}: expected a number, a text, a list or a table, found {found}")


def _sentence(errors: Sequence[ErrorDetails], known: Any, content: Any, key: str) -> str:  # noqa: ANN401 (as _checked)
    """The first thing that is wrong; errors about the same place are what its alternatives expected.

    Where a value is missing and there is a name that is none, that one is told: it is likely to be meant for the other.
    """
    first = errors[0]
    if first["type"] == "missing":
        first = next((error for error in errors if error["type"] in UNKNOWN), first)
    if isinstance(_place(first, content)[1], Mapping):  # of which another branch of a union may say what is wrong in it
        first = max(errors, key=lambda error: len(_place(error, content)[0]))
    place, found = _place(first, content)
    name = ".".join(filter(None, (key, *place)))
    alternatives = [error for error in errors if _place(error, content)[0] == place]
    kinds = {error["type"] for error in alternatives}
    if kinds <= UNKNOWN:
        names = _names(known, place[:-1])
        return unknown("setting", place[-1], names, prefix="".join(f"{part}." for part in filter(None, (key, *place[:-1]))))
    words = [word for error in alternatives for word in re.findall(r"'([^']*)'", str(error.get("ctx", {}).get("expected", "")))]
    if words and isinstance(found, str):
        others = [_words(error) for error in alternatives if error["type"] != "literal_error"]
        return unknown(f"value of {name}:", found, [*words, *others])
    texts = ", ".join(words)
    expected = list(dict.fromkeys((e["type"] == "literal_error" and texts) or _words(e) for e in alternatives))
    return f"{name}: expected {' or '.join(expected)}, found {found!r:.100}"


def _words(error: ErrorDetails) -> str:
    return EXPECTED[error["type"]].format(**error.get("ctx", {})) if error["type"] in EXPECTED else error["msg"]


def _place(error: ErrorDetails, content: Any) -> tuple[tuple[str, ...], Any]:  # noqa: ANN401 (JSON)
    """The keys that lead to what is wrong, without what pydantic adds (such as the branch of a union), and the value."""
    place: list[str] = []
    for part in error["loc"]:
        if isinstance(content, Mapping) and part in content:
            content = content[str(part)]
        elif isinstance(content, list | tuple) and isinstance(part, int) and part < len(content):
            content = content[part]
        elif error["type"] == "missing" and part == error["loc"][-1]:
            content = None
        else:
            continue  # the name of a branch
        place.append(str(part))
    return tuple(place), content


def _names(known: Any, place: Sequence[str]) -> list[str]:  # noqa: ANN401 (a class or names)
    """The fields of the dataclass at a place inside ``known``."""
    for part in place:
        if dataclasses.is_dataclass(known):
            hint = get_type_hints(known).get(part, known)  # a number in a list is the name of no field
            known = next(_dataclasses_in(hint), hint)
    return [field.name for field in dataclasses.fields(known)] if dataclasses.is_dataclass(known) else list(known)


def _dataclasses_in(hint: Any) -> Iterator[type]:  # noqa: ANN401 (a type, or part of one)
    """The dataclasses that a type is made of, such as those of lists and unions."""
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from _dataclasses_in(part)


def _forbidding(kind: type[T]) -> type[T]:
    """``kind``, whose tables, and those inside, take no other names and no NaN or infinity."""
    for one in (kind, *(part for hint in get_type_hints(kind).values() for part in _dataclasses_in(hint))):
        if "__pydantic_config__" not in vars(one):
            setattr(one, "__pydantic_config__", STRICT)  # noqa: B010 (which no type has a name for)
            if one is not kind:
                _forbidding(one)
    return kind
