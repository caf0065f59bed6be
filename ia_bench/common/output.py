"""What a command says, on streams that may be closed, full, or read by nobody: no work is lost for want of a listener."""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from typing import TextIO

log = logging.getLogger("ia_bench")
"""Where notes go that nobody takes: of this package as a library, whose user decides what becomes of them."""


def say(text: str, stream: TextIO | None) -> None:
    """Print a line; where that fails, this and all that follows is dropped. ``stream``: None in a process that has none."""
    if stream is None:
        return
    try:
        print(text, file=stream, flush=True)
    except (OSError, ValueError):  # a full disk, a pipe that is closed at the other end, a closed file
        with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:  # else Python tries again when it ends, and ends
            os.dup2(nowhere.fileno(), stream.fileno())  # with a status of its own
