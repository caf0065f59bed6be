"""metrics.json: what it holds, checked before it is written and whenever it is read."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json

METRICS_FILE = "metrics.json"
SCHEMA = 2

METRICS_KEYS: dict[str, type] = {
    "schema": int,
    "row": str,
    "scene": str,
    "seed": int,
    "protocol": str,
    "config_hash": str,
    "status": str,
    "sees_truth": bool,
    "metrics": dict,
    "per_image": dict,
    "time_s": dict,
    "peak_memory_bytes": int,
    "rays": int,
    "network_calls": int,
    "plan": dict,
    "environment": dict,
    "files": dict,
}
"""Keys that metrics.json of a finished run must have, and their types. More keys are allowed."""

FAILED_KEYS = ("schema", "row", "scene", "seed", "protocol", "config_hash", "status")
"""The keys that a failed run still has, besides ``error``."""


class RecordError(ValueError):
    """A record that no program can rely on: a missing key, a wrong type, NaN or infinity."""


def read_metrics(folder: Path) -> dict[str, Any]:
    """The metrics.json of a run folder, finished or failed, with every key that its status asks for.

    Raises FileNotFoundError where there is none, and InputError, naming file and key, for what is none.
    """
    path = folder / METRICS_FILE
    if not os.path.lexists(path):
        raise FileNotFoundError(path)
    metrics = read_json(path)
    try:
        check_metrics(metrics)
    except RecordError as error:
        raise InputError(f"{path}: {error}; delete its folder to run again") from None
    return metrics


def finished_metrics(folder: Path, config_hash: str) -> dict[str, Any] | None:
    """The metrics in a run's folder if they are of this configuration and of no failure, else None. Takes no lock."""
    try:
        metrics = read_metrics(folder)
    except FileNotFoundError:
        return None
    return metrics if metrics["status"] == "ok" and metrics["config_hash"] == config_hash else None


def damaged_file(folder: Path, metrics: Mapping[str, Any]) -> str | None:
    """The first of a finished run's files that is gone or is not what the run wrote; None if all are there."""
    return next((name for name, digest in metrics["files"].items() if digest_of(folder / name) != digest), None)


def digest_of(path: Path) -> str | None:
    """SHA-256 (hex) of a file, None where there is no such file."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def check_metrics(metrics: Mapping[str, Any]) -> None:
    """Raise RecordError naming the first key of metrics.json that is missing, of the wrong type or null unexplained.

    ``reasons`` explains every null by its dotted name: ``{"albedo.psnr": "no scored pixel"}``.
    """
    status = metrics.get("status")
    if status not in ("ok", "failed"):
        raise RecordError(f"status: expected 'ok' or 'failed', found {status!r}")
    required = METRICS_KEYS if status == "ok" else {key: METRICS_KEYS[key] for key in FAILED_KEYS} | {"error": str}
    reasons = metrics.get("reasons", {})
    _check_table("reasons", reasons, str)
    if metrics.get("schema") != SCHEMA:
        raise RecordError(f"schema: expected {SCHEMA}, found {metrics.get('schema')!r}")
    for key, kind in required.items():
        if key not in metrics:
            raise RecordError(f"{key}: missing")
        value = metrics[key]
        if value is None and reasons.get(key):
            continue
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise RecordError(f"{key}: expected {kind.__name__}, found {value!r}")
    if status == "ok":
        _check_table("time_s", metrics["time_s"], int | float)
        _check_table("files", metrics["files"], str)
    for key in ("metrics", "variants"):
        _check_table(key, metrics.get(key, {}), dict)
    for key in ("protocol_description", "rescored_from"):
        if not isinstance(metrics.get(key, {}), dict):
            raise RecordError(f"{key}: expected dict, found {metrics[key]!r}")
    refuse_non_finite(metrics, METRICS_FILE)
    for key in ("metrics", "variants"):
        _check_values(key, metrics.get(key, {}), "", reasons)


def json_bytes(content: Any, name: str) -> bytes:  # noqa: ANN401 (any JSON value)
    """The content of the JSON file ``name``. Raises RecordError naming the first key that is NaN, infinite or no JSON type."""
    refuse_non_finite(content, name)
    try:
        return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    except TypeError as error:
        raise RecordError(f"{name}: {error}") from None


def refuse_non_finite(value: Any, where: str) -> None:  # noqa: ANN401 (any JSON value)
    """Raise RecordError naming the first NaN or infinity in a JSON value that is called ``where``."""
    if isinstance(value, float) and not math.isfinite(value):
        raise RecordError(f"{where}: is {value}; an undefined value is null with a reason")
    if isinstance(value, Mapping):
        for key, item in value.items():
            refuse_non_finite(item, f"{where}: {key}" if ": " not in where else f"{where}.{key}")
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            refuse_non_finite(item, f"{where}[{number}]")


def _check_table(key: str, table: Any, kind: Any) -> None:  # noqa: ANN401 (whatever stands there, and any type)
    if not isinstance(table, Mapping):
        raise RecordError(f"{key}: expected dict, found {table!r}")
    for name, value in table.items():
        if not isinstance(value, kind) or isinstance(value, bool):
            raise RecordError(f"{key}.{name}: expected {getattr(kind, '__name__', 'a number')}, found {value!r}")


def _check_values(where: str, group: Mapping[str, Any], prefix: str, reasons: Mapping[str, str]) -> None:
    """Metrics are numbers in named groups; an undefined one is None, with its reason under its dotted name."""
    for key, value in group.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            _check_values(where, value, f"{name}.", reasons)
        elif value is None:
            if not reasons.get(name):
                raise RecordError(f"{where}.{name}: is null without a reason; say why in reasons['{name}']")
        elif not isinstance(value, int | float) or isinstance(value, bool):
            raise RecordError(f"{where}.{name}: expected a number, found {value!r}")
