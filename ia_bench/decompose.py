"""``python -m ia_bench.decompose`` and ``from ia_bench.decompose import decompose``: one picture, split by a prior alone."""

from ia_bench.runs.decomposition import Decomposition, decompose

__all__ = ["Decomposition", "decompose"]

if __name__ == "__main__":
    from ia_bench.cli.decompose import main

    raise SystemExit(main())
