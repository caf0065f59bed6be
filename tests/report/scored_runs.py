"""Runs as a report reads them, without their folders."""

from __future__ import annotations

from pathlib import Path

from ia_bench.report.collect import SCORES, Record


def scored(row: str, scene: str, seed: int, value: float | None, **changes: object) -> Record:
    """A finished run whose every score and cost is ``value``."""
    cell = {"folder": Path("here"), "row": row, "scene": scene, "seed": seed, "protocol": "p"}
    return {**cell, **dict.fromkeys(SCORES, value), **changes}
