"""One answer of a check: what was asked, what was expected, what was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
