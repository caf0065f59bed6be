"""How a command ends: the exit statuses of every command, and the one line that explains a failure."""

from __future__ import annotations

import errno
import io
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial, wraps
from types import FrameType
from typing import ParamSpec, TextIO

from ia_bench.common.errors import Fault, InputError, PluginError, printable
from ia_bench.common.files import shown

P = ParamSpec("P")
log = logging.getLogger("ia_bench")
"""Where notes go that nobody takes: of this package as a library, whose user decides what becomes of them."""
STREAMS = {"stdout": 1, "stderr": 2}
NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)  # what a system says of names that nothing can have: of those that a user gave
OK, FAULT, MISTAKE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143


class Terminated(KeyboardInterrupt):
    """SIGTERM, which a cluster sends before it takes the machine: it ends a command as Ctrl-C does."""


def say(text: str, stream: TextIO | None) -> None:
    """Print a line; where that fails, this and all that follows is dropped. ``stream``: None in a process that has none."""
    if stream is None:
        return
    try:
        print(text, file=stream, flush=True)
    except UnicodeEncodeError:  # a terminal that has not all letters
        print(text.encode("ascii", "backslashreplace").decode(), file=stream, flush=True)
    except (OSError, ValueError):  # a full disk, a pipe that is closed at the other end, a closed file
        with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:  # else Python tries again when it ends, and ends
            os.dup2(nowhere.fileno(), stream.fileno())  # with a status of its own


@contextmanager
def streams_kept() -> Iterator[None]:
    """Put standard output and error back as they were, however the block ends: closed, exchanged, or led elsewhere by a plugin."""
    copies = dict[int, int]()
    kept = [(name, stream, getattr(stream, "encoding", None)) for name in STREAMS if (stream := getattr(sys, name)) is not None]
    for number in STREAMS.values():
        with suppress(OSError):  # of a process that has none
            copies[number] = os.dup(number)
    try:
        yield
    finally:
        for number, copy in copies.items():
            os.dup2(copy, number)
            os.close(copy)
        for name, stream, encoding in kept:
            if not _is_open(stream):
                file = io.BufferedWriter(io.FileIO(STREAMS[name], "w", closefd=False))
                stream = io.TextIOWrapper(file, encoding, "backslashreplace", line_buffering=True)
            setattr(sys, name, stream)


def _is_open(stream: TextIO) -> bool:
    try:
        return not getattr(stream, "closed", False)
    except ValueError:  # whose buffer was taken away
        return False


def complain(message: str, status: int = MISTAKE) -> int:
    """Print one message on stderr and return the exit status, which is that of a mistake unless said otherwise.

    IA_BENCH_DEBUG=1 shows the traceback of the exception that it is about, and of its causes.
    """
    if os.environ.get("IA_BENCH_DEBUG") == "1" and sys.exc_info()[0] is not None:
        say(traceback.format_exc(), sys.stderr)
    say(f"ia_bench: {printable(message)}", sys.stderr)
    return status


def status_of(work: Callable[[], int], *, resumes: bool = False) -> int:
    """Do a command's work and return its exit status; what ended it early is said in one line.

    A fault of the program has its traceback, and so has everything else under IA_BENCH_DEBUG=1. ``resumes``: whether the same
    command goes on after an interruption, and does not begin again; a KeyboardInterrupt may say otherwise.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()  # nobody else may set what a signal does

    def terminate(number: int, frame: FrameType | None) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, terminate) if in_main_thread else None
    try:
        return work()
    except KeyboardInterrupt as stop:
        status = TERMINATED if isinstance(stop, Terminated) else INTERRUPTED
        then = stop.args[0] if stop.args else f"; the same command {'resumes' if resumes else 'starts over'}"
        return complain(f"interrupted{then}", status)
    except (InputError, Fault, FloatingPointError, OSError) as error:  # the last two say themselves which numbers, or which file
        if isinstance(error, OSError) and error.errno in NO_NAME:
            return complain(f"{shown(error.filename)}: expected the name of a file or folder, found: {error.strerror}")
        mistake = isinstance(error, InputError) and not isinstance(error, PluginError)
        return complain(str(error), MISTAKE if mistake else FAULT)
    except Exception:
        say(traceback.format_exc(), sys.stderr)
        return FAULT
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


def exits(*, resumes: bool = False) -> Callable[[Callable[P, int]], Callable[P, int]]:
    """Make ``main`` of a command return its exit status however it ends (:func:`status_of`)."""

    def ended(main: Callable[P, int]) -> Callable[P, int]:
        return wraps(main)(lambda *args, **kwargs: status_of(partial(main, *args, **kwargs), resumes=resumes))

    return ended


def command(
    usage: Callable[[], str], work: Callable[[list[str]], int], arguments: Sequence[str] | None, *, resumes: bool = False
) -> int:
    """Show the help where it is asked for, else do a command's work on its arguments (None: those of this process).

    Returns the exit status (:func:`status_of`).
    """
    for number in range(3):  # where whoever called us has closed one, a file of results would get its number
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # which takes the lowest that is free
    given = sys.argv[1:] if arguments is None else list(arguments)
    if not {"-h", "--help"}.isdisjoint(given):
        say(usage().rstrip(), sys.stdout)
        return OK
    return status_of(lambda: work(given), resumes=resumes)
