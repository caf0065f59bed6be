"""``python -m ia_bench.table``: every row x scene x seed of a table, then the report; :mod:`ia_bench.cli.table` does the work."""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from ia_bench.cli.table import main

if TYPE_CHECKING:
    import pandas as pd

    from ia_bench.facade import Fit


class _Callable(ModuleType):
    """The module stands in for the function of its name, over which Python writes it when it is imported."""

    def __call__(self, runs: "Sequence[Fit | str | Path]") -> "pd.DataFrame":
        """See :func:`ia_bench.facade.table`."""
        from ia_bench.facade import table

        return table(runs)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    raise SystemExit(main())
