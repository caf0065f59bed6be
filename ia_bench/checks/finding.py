"""One answer of a check: what was asked, what was expected, what was found; and what everything that is checked may raise."""

from __future__ import annotations

import os
import random
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from typing import Literal

import numpy as np
import torch

from ia_bench.common import registry
from ia_bench.common.errors import InputError, raised
from ia_bench.common.exit_codes import say

Status = Literal["pass", "fail", "skip"]


@dataclass(frozen=True)
class Finding:
    """One line of a list: ``what`` was checked, what was ``expected``, what was ``found`` (or why it was skipped)."""

    status: Status
    what: str
    expected: str
    found: str


def judge(holds: bool, what: str, expected: str, found: str) -> Finding:
    """A pass or a failure."""
    return Finding("pass" if holds else "fail", what, expected, found)


def guarded(what: str, expected: str, rule: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """What a rule finds; what it raises is a failure called ``what``, and goes no further."""
    try:
        yield from rule()
    except (Exception, SystemExit) as error:
        yield Finding("fail", what, expected, told(error))


def told(error: BaseException) -> str:
    """What an exception says, and where it was raised unless it says itself what is wrong; IA_BENCH_DEBUG=1 shows its traceback."""
    if os.environ.get("IA_BENCH_DEBUG") == "1":
        say("".join(traceback.format_exception(error)), sys.stderr)
    return raised(error) if isinstance(error, InputError) else registry.told(error)


@contextmanager
def other_chance(number: int) -> Iterator[None]:
    """Inside the block the generators of the whole process are in another state for each ``number``: nothing may depend on it."""
    with registry.process_state_kept():
        random.seed(number)
        np.random.seed(number)
        torch.manual_seed(number)
        yield


def difference(one: object, two: object, where: str = "scene") -> str | None:
    """Where two scenes differ first, None if they are equal."""
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        return None if one.dtype == two.dtype and np.array_equal(one, two) else where
    if type(one) is not type(two):
        return where
    if is_dataclass(one):
        pairs = [(f"{where}.{field.name}", getattr(one, field.name), getattr(two, field.name)) for field in fields(one)]
    elif isinstance(one, dict) and isinstance(two, dict):
        pairs = [(f"{where}[{key!r}]", one.get(key), two.get(key)) for key in {**one, **two}]
    elif isinstance(one, tuple) and isinstance(two, tuple) and len(one) == len(two):
        pairs = [(f"{where}[{i}]", *pair) for i, pair in enumerate(zip(one, two, strict=True))]
    else:
        return None if one == two else where
    return next((found for name, a, b in pairs if (found := difference(a, b, name)) is not None), None)
