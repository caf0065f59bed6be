"""``python -m ia_bench.table``: every row x scene x seed of a table, then the report; :mod:`ia_bench.cli.table` does the work."""

from ia_bench.cli.table import main

if __name__ == "__main__":
    raise SystemExit(main())
