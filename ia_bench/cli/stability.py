"""``ia-bench stability [NAME]``: extreme inputs, one line each, against what the answer must be; they are tests of a checkout."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, command
from ia_bench.common.paths import PACKAGE

CASES = PACKAGE.parent / "tests" / "stability"
USAGE = """\
ia-bench stability [NAME]

Gives the renderer, the fit and the scores extreme inputs (lights of 1e6 and of 0, roughness 0 and 1, grazing views, empty
masks, ...), and says of each, in a line, whether the answer is what it must be. NAME: those alone whose name has it in it.
Minutes; the cases are tests, so it wants a checkout of the project and pytest.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status, which is 1 where an answer is wrong."""
    return command(lambda: USAGE, _work, arguments)


def _work(arguments: list[str]) -> int:
    if len(arguments) > 1 or any(text.startswith("-") for text in arguments):
        raise InputError(f"ia-bench stability: expected a name at most, found {' '.join(arguments)}")
    if not CASES.is_dir() or find_spec("pytest") is None:
        raise InputError(
            f"{CASES}: expected the cases of a checkout, and pytest, found {'no pytest' if CASES.is_dir() else 'none'}"
        )
    chosen = ["-k", arguments[0]] if arguments else []
    tests = [sys.executable, "-m", "pytest", "-m", "stability", "-v", *chosen, str(CASES)]
    return OK if subprocess.run(tests, cwd=CASES.parents[1]).returncode == 0 else FAULT
