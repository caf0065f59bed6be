"""``python -m ia_bench.stability``: the table of extreme cases, which lie in tests/stability of a checkout."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from ia_bench.common.exit_codes import complain
from ia_bench.common.paths import PACKAGE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run tests/stability/table.py and return its exit status, or that of a mistake where there is no checkout."""
    tests = PACKAGE.parent / "tests"
    if not (tests / "stability" / "table.py").is_file():
        return complain(f"{tests}/stability: expected the cases, found none: this command needs a checkout of the project")
    sys.path.insert(0, str(tests))
    return int(importlib.import_module("stability.table").main(arguments))
