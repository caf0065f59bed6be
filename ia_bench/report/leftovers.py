"""Files of a former report in the folder of a new one, which would be read as part of it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path


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
