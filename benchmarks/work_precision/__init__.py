"""Error against run time of renders and whole fits: ``python -m benchmarks.work_precision``."""
