"""``python -m ia_bench.preview``: pictures of a run's glTF asset; :mod:`ia_bench.cli.preview` does the work."""

from ia_bench.cli.preview import main

if __name__ == "__main__":
    raise SystemExit(main())
