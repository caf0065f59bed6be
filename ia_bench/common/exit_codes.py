"""How a command ends: the exit statuses of every ``python -m ia_bench...``, and the one line that explains a failure."""

from __future__ import annotations

import sys

OK, FAULT, MISTAKE, INTERRUPTED = 0, 1, 2, 130


def complain(message: str, status: int = MISTAKE) -> int:
    """Print one message on stderr and return the exit status, which is that of a mistake unless said otherwise."""
    print(f"ia_bench: {message}", file=sys.stderr)
    return status
