"""Error against run time of renders: ``python -m benchmarks.work_precision``."""
