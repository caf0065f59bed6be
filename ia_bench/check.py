"""``python -m ia_bench.check``: does a plugin keep its contract?; :mod:`ia_bench.cli.check` does the work."""

from ia_bench.cli.check import main

if __name__ == "__main__":
    raise SystemExit(main())
