"""What priors and methods of inverse rendering are worth, by one protocol: docs/architecture.md says where things are.

``import ia_bench as ib`` is the front door for Python (docs/python.md); its parts are imported when they are first used.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ia_bench.common.errors import InputError
    from ia_bench.facade import Fit, LoadedScene, fit, load, score, table
    from ia_bench.runs.decomposition import decompose

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when torch is loaded: its idle threads leave their core to our kernels

__all__ = ["Fit", "InputError", "LoadedScene", "decompose", "fit", "load", "score", "table"]
_ELSEWHERE = {"InputError": "ia_bench.common.errors", "decompose": "ia_bench.runs.decomposition"}


def __getattr__(name: str) -> Any:  # noqa: ANN401 (PEP 562)
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_ELSEWHERE.get(name, "ia_bench.facade")), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
