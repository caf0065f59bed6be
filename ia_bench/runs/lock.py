"""One process at a time in a run's folder."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ia_bench.common.errors import InputError


def lock_folder(path: Path, note: Callable[[str], None]) -> BinaryIO:
    """Make the folder if need be, wait until no other process holds it, and return the file that holds it now.

    Closing the file lets go. It stays in the folder, so that nobody can lock a file that is already gone; it is neither
    written nor emptied, and not followed where it is a symbolic link. Its time is when it was locked last (:func:`held_since`).
    Raises InputError for a folder that cannot be used.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = os.fdopen(os.open(path / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "rb")
    except OSError as error:
        why = "its .lock is a symbolic link" if error.errno == errno.ELOOP else error.strerror
        raise InputError(f"{path}: cannot be used as a run's folder ({why})") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            note(f"{path}: another process is working on this run; waiting for it to finish")
            fcntl.flock(lock, fcntl.LOCK_EX)
        with suppress(OSError):  # a file system that keeps no times
            os.utime(lock.fileno())
    except BaseException:
        lock.close()
        raise
    return lock


def held_since(path: Path) -> float | None:
    """Since when a process has been working in a run's folder, in seconds of the clock; None where none is.

    Nothing is made or changed; a process that begins just now waits for a moment.
    """
    try:
        lock = os.open(path / ".lock", os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.fstat(lock).st_mtime
    finally:
        os.close(lock)
    return None
