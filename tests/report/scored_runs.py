"""Runs as a report reads them, without their folders."""

import csv
import json
from pathlib import Path
from typing import Any

from ia_bench.report.collect import SCORES, Record


def scored(row: str, scene: str, seed: int, value: float | None, **changes: object) -> Record:
    """A finished run whose every score and cost is ``value``."""
    cell = {"folder": Path("here"), "row": row, "scene": scene, "seed": seed, "protocol": "p"}
    return {**cell, **dict.fromkeys(SCORES, value), **changes}


def put_setup(folder: Path, identity: dict[str, Any] | None = None, **more: object) -> Path:
    """Write the config.json of a run folder: what decides its numbers, and ``config`` and ``command``."""
    (folder / "config.json").write_text(json.dumps({"config_hash": "0", "identity": identity or {}, **more}))
    return folder


def lines_of(path: Path, *keys: str) -> dict[object, dict[str, str]]:
    """The lines of a CSV file by some of their columns."""
    with path.open(newline="") as file:
        return {tuple(line[key] for key in keys): line for line in csv.DictReader(file)}
