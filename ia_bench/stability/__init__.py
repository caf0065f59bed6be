"""Stiff and extreme inputs, each with the answer it must have: ``python -m ia_bench.stability``."""
