"""``python -m ia_bench``: one run, or a sweep of runs; :mod:`ia_bench.cli.run` does the work."""

from ia_bench.cli.run import main

if __name__ == "__main__":
    raise SystemExit(main())
