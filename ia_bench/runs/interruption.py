"""SIGINT and SIGTERM while a run is at work: its state is saved first, so that nothing is done twice."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from ia_bench.common.exit_codes import Terminated

GRACE_SECONDS = 10
"""A method that has not saved its state in this time after it was asked is interrupted where it stands."""

_asked: type[KeyboardInterrupt] | None = None


def asked() -> bool:
    """Whether the run shall save its state now, after which it ends."""
    return _asked is not None


def end_if_asked() -> None:
    """Called with the state safe on disk. Raises KeyboardInterrupt, or Terminated, if somebody has asked the run to end."""
    if _asked is not None:
        raise _asked


@contextmanager
def deferred() -> Iterator[None]:
    """Inside the block a first SIGINT or SIGTERM only asks; a second Ctrl-C, or the end of the grace, interrupts at once."""
    global _asked
    if threading.current_thread() is not threading.main_thread():  # nobody else may set what a signal does
        yield
        return
    before = {number: signal.signal(number, _ask) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    try:
        yield
        end_if_asked()
    finally:
        signal.alarm(0)
        _asked = None
        for number, handler in before.items():
            signal.signal(number, handler)


def _ask(number: int, frame: FrameType | None) -> None:
    global _asked
    if number == signal.SIGALRM or (_asked is KeyboardInterrupt and number == signal.SIGINT):
        end_if_asked()
    elif _asked is None:
        _asked = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        signal.alarm(GRACE_SECONDS)
