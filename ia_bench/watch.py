"""``python -m ia_bench.watch RUNS``: the page of a table while it is being made; :mod:`ia_bench.cli.watch` does the work."""

from ia_bench.cli.watch import main

if __name__ == "__main__":
    raise SystemExit(main())
