"""``python -m ia_bench.stability``: extreme inputs against what the answer must be; :mod:`ia_bench.cli.stability` does the work."""

from ia_bench.cli.stability import main

if __name__ == "__main__":
    raise SystemExit(main())
