"""Files that are whole or absent, however the one who writes them ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside ``path``, with the same ending, to write to; it becomes ``path`` when the block ends without an exception.

    Until then what ``path`` held before stays readable. Of several processes that write the same file the last one wins.
    """
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
