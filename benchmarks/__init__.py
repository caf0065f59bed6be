"""Speed, precision and what a fit meets, measured: scripts, and packages run as ``python -m benchmarks.NAME``."""
