"""Files and folders that are whole or absent, however the one who writes them ends."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

LEFTOVERS = ".tmp-*"  # names of files that somebody was writing; those of a process that was killed stay behind


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside ``path``, with the same ending, to write to; it becomes ``path`` when the block ends without an exception.

    Until then what ``path`` held before stays readable; from then on the new content survives a power cut. Of several
    processes that write the same file, be it on several machines, the last one wins.
    """
    partial = path.with_name(f".tmp-{os.getpid()}-{secrets.token_hex(4)}-{path.name}")
    try:
        yield partial
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(partial, path)
        folder = os.open(path.parent, os.O_RDONLY)  # on Linux the entry in the folder is a write of its own
        try:
            with suppress(OSError):  # which some network shares do not know
                os.fsync(folder)
        finally:
            os.close(folder)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """An empty folder to write to; it becomes ``path``, which is absent or empty, when the block ends without an exception.

    Of an empty folder that is there only the content is new: it may be a mount, or where somebody is.
    """
    home = path if path.exists() else path.parent
    with TemporaryDirectory(prefix=".tmp-", dir=home) as around:
        place = Path(around, "new")
        place.mkdir()  # for whom new folders are; the one around it is for this user alone
        yield place
        for part in [place] if home != path else list(place.iterdir()):
            os.replace(part, path if part == place else path / part.name)
