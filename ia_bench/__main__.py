"""``python -m ia_bench ...``: ``ia-bench run ...``, or another command of ``ia-bench`` that comes first."""

import sys

from ia_bench.cli.main import COMMANDS, main

if __name__ == "__main__":
    given = sys.argv[1:]
    raise SystemExit(main(given if given and given[0] in COMMANDS else ["run", *given]))
