"""Files that are whole or absent, however the one who writes them ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LEFTOVERS = ".tmp-*"
"""Names of files that somebody was writing; those of a process that was killed stay behind."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside ``path``, with the same ending, to write to; it becomes ``path`` when the block ends without an exception.

    Until then what ``path`` held before stays readable; from then on the new content survives a power cut. Of several
    processes that write the same file the last one wins.
    """
    partial = path.with_name(f".tmp-{os.getpid()}-{path.name}")
    try:
        yield partial
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(partial, path)
        folder = os.open(path.parent, os.O_RDONLY)  # on Linux the entry in the folder is a write of its own
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    finally:
        partial.unlink(missing_ok=True)
