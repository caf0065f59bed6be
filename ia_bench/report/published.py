"""Read the runs of a published table back from its runs.csv, so that new rows can be compared without running old ones again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.report.collect import HASH_DIGITS, Run
from ia_bench.scores.columns import METRIC_OF, METRICS

LABELS = ("protocol", "row", "scene", "seed", "status", "reason", "sees_truth")
COSTS = ("seconds", "peak_memory_bytes")
ABOUT = ("config_hash", "rays", "network_calls", "commit", "cpu")  # and rescored_from_*
TIMES = "seconds_"  # what the columns of phases begin with
GEOMETRY = "geometry_"  # and those of a shape that was made for the run


def read_published(path: Path) -> list[Run]:
    """The runs of a runs.csv, as a report wrote it. Curves and pictures are not in it.

    Raises InputError, naming file and line, where a column is missing or a value is not what its column holds.
    """
    try:
        lines = pd.read_csv(path, dtype=str, keep_default_na=False).to_dict("records")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a report's runs.csv, found: {error}") from error
    wanted = [*LABELS, *(metric.column for metric in METRICS), *COSTS]
    missing = next((name for name in wanted if not lines or name not in lines[0]), None)
    if missing is not None:
        raise InputError(f"{path}: expected a report's runs.csv, found no column {missing} or no line below it")
    return [_run(path, number, line) for number, line in enumerate(lines, start=2)]  # line 1 is the header


def _run(path: Path, number: int, line: Mapping[str, str]) -> Run:
    def value(column: str) -> float | None:
        if line[column] == "":
            return None
        try:
            found = float(line[column])
        except ValueError:
            found = math.nan
        if not math.isfinite(found):
            raise InputError(f"{path}, line {number}, {column}: expected a number, found {shown(repr(line[column]))}")
        return found

    def chosen(column: str, among: Mapping[str, bool], text: str) -> bool:
        if text not in among:
            raise InputError(f"{path}, line {number}, {column}: expected {' or '.join(among)}, found {shown(repr(line[column]))}")
        return among[text]

    seed = value("seed")
    if seed is None or seed != int(seed) or not line["row"] or not line["scene"]:
        raise InputError(f"{path}, line {number}: expected a row, a scene and a whole seed, found {shown(repr(dict(line)))}")
    about: dict[str, Any] = {key: line[key] for key in line if key in ABOUT or key.startswith("rescored_from_")}
    about["config_hash"] = about.get("config_hash", "")[:HASH_DIGITS]
    sees_truth = chosen("sees_truth", {"true": True, "false": False}, line["sees_truth"].strip().lower())
    cell = Run(path, line["row"], line["scene"], int(seed), about=about, sees_truth=sees_truth)
    if not chosen("status", {"ok": True, "failed": False}, line["status"]):
        return replace(cell, problem=line["reason"] or "failed")
    phases = {key.removeprefix(TIMES): value(key) for key in line if key.startswith(TIMES)}
    known = {*LABELS, *COSTS, *about, *(metric.column for metric in METRICS)}
    others = [key for key in line if key not in known and not key.startswith(TIMES)]
    metrics = {metric.key: value(metric.column) for metric in METRICS}
    memory = value("peak_memory_bytes")
    return replace(
        cell,
        protocol=line["protocol"],
        metrics=metrics,
        variants={_variant(key): value(key) for key in others},
        reasons=_reasons(line["reason"]),
        phases={phase: seconds for phase, seconds in phases.items() if seconds is not None},
        seconds=value("seconds"),
        peak_memory_bytes=None if memory is None else int(memory),
    )


def _variant(column: str) -> str:
    """The key of a variant by its column: group and name, of which one or the other may hold underscores."""
    geometry = column.removeprefix(GEOMETRY)
    return f"geometry.{geometry}" if geometry != column else ".".join(column.rsplit("_", 1))


def _reasons(text: str) -> dict[str, str]:
    """Why metrics are null, by their keys: "key, key: why; key: why". A reason may hold colons and semicolons of its own."""
    found: dict[str, str] = {}
    mine: list[str] = []
    for part in text.split("; "):
        keys, colon, why = part.partition(": ")
        if colon and METRIC_OF.keys() >= set(keys.split(", ")):
            mine = keys.split(", ")
            found |= dict.fromkeys(mine, why)
        else:
            found |= {key: f"{found[key]}; {part}" for key in mine}
    return found
