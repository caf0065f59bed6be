"""How a command ends: the exit statuses of every ``python -m ia_bench...``, and the one line that explains a failure."""

from __future__ import annotations

import os
import sys
import traceback

from ia_bench.common.files import printable

OK, FAULT, MISTAKE, INTERRUPTED = 0, 1, 2, 130


def complain(message: str, status: int = MISTAKE) -> int:
    """Print one message on stderr and return the exit status, which is that of a mistake unless said otherwise.

    IA_BENCH_DEBUG=1 shows the traceback of the exception that it is about, and of its causes.
    """
    if os.environ.get("IA_BENCH_DEBUG") == "1" and sys.exc_info()[0] is not None:
        traceback.print_exc()
    print(f"ia_bench: {printable(message)}", file=sys.stderr)
    return status
