"""Texts and tables as files, and what a former report has left beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from ia_bench.common.atomic_file import whole_file

DIGITS = 7
"""Significant digits of what was computed from runs; those themselves are written as they are."""


def write_text(path: Path, text: str) -> Path:
    """Write a file at once or not at all, and return its path; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def csv_text(records: Iterable[Mapping[str, Any]]) -> str:
    """A line per record below the names of all columns; empty where a record has no value."""
    rounded = [
        {key: float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for key, value in record.items()}
        for record in records
    ]
    return str(pd.DataFrame(rounded, dtype=object).to_csv(index=False))


def begins_with(path: Path, title: str) -> bool:
    """Whether a text file begins with ``title``, by which a report knows a file of its own."""
    try:
        with path.open("rb") as file:
            return file.read(len(title.encode())) == title.encode()
    except OSError:
        return False


def remove_all_but(written: Collection[Path], known: Iterable[Path]) -> None:
    """Remove the files among ``known`` that have not been ``written`` this time. What is no file, or cannot be removed, stays."""
    for path in known:
        if path not in written and path.is_file():
            with suppress(OSError):
                path.unlink()
