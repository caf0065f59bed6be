"""``ia-bench decompose`` and ``ia_bench.decompose(image)``: one picture, split by a prior alone."""

import sys
from types import ModuleType

from ia_bench.runs.decomposition import Decomposition, decompose

__all__ = ["Decomposition", "decompose"]


class _Callable(ModuleType):
    """The module stands in for the function of its name, over which Python writes it when it is imported."""

    __call__ = staticmethod(decompose)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    from ia_bench.cli.decompose import main

    raise SystemExit(main())
