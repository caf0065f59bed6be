"""One answer of a check: what was asked, what was expected, what was found; and what everything that is checked may raise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from ia_bench.common.errors import raised

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
        yield Finding("fail", what, expected, raised(error))
