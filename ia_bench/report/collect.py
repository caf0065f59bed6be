"""Read run folders: metrics.json and curve.csv, nothing else. What cannot be read is named and counts as a failure."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.runs.metrics import SCHEMA
from ia_bench.scores.columns import CURVE_METRICS, METRICS

Cell = tuple[str, str, int]  # row, scene, seed


class BadRecord(ValueError):
    """A file of a run folder is not what the format says."""


@dataclass(frozen=True)
class Curve:
    """Error against run time: ``stages`` (N,) names, ``steps`` (N,), ``seconds`` (N,) of optimisation without scoring.

    ``values``: column of curve.csv -> (N,) float64, NaN where not measured.
    """

    stages: tuple[str, ...]
    steps: np.ndarray
    seconds: np.ndarray
    values: dict[str, np.ndarray]

    @property
    def is_ceiling(self) -> bool:
        """Whether this is no optimisation but ground truth through the renderer: a level, not a curve."""
        return set(self.stages) == {"ceiling"}

    def measured(self, column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steps, seconds and values of one column where it has a finite value."""
        values = self.values.get(column, np.full(len(self.steps), np.nan))
        there = np.isfinite(values)
        return self.steps[there], self.seconds[there], values[there]


@dataclass(frozen=True)
class Run:
    """One cell of the table. ``problem`` says why it failed, None for a finished run.

    ``metrics``: :attr:`Metric.key` -> value, None where null.
    """

    folder: Path
    row: str
    scene: str
    seed: int
    problem: str | None = None
    protocol: str | None = None
    metrics: dict[str, float | None] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    seconds: float | None = None  # of all phases without scoring, also where a run was interrupted or samples were kept
    peak_memory_bytes: float | None = None
    commit: str | None = None
    cpu: str | None = None
    sees_truth: bool = False
    curve: Curve | None = None
    curve_problem: str | None = None


@dataclass(frozen=True)
class Collection:
    """All runs found, and the folders (with the problem) that do not even say which cell they are."""

    runs: tuple[Run, ...]
    unreadable: tuple[tuple[Path, str], ...] = ()


def find_run_folders(root: Path) -> list[Path]:
    """Every folder below ``root`` that holds a metrics.json, sorted."""
    return sorted(path.parent for path in root.rglob("metrics.json"))


def collect(folders: Iterable[Path] | Mapping[Path, Cell]) -> Collection:
    """Read the given run folders. A mapping says which cell each folder is for: its row may have been renamed since.

    Raises ValueError where two folders hold the same row, scene and seed: neither would be the right one to show.
    """
    cells = folders if isinstance(folders, Mapping) else {}
    runs: dict[Cell, Run] = {}
    unreadable = []
    for folder in folders:
        try:
            run = read_run(folder)
        except BadRecord as problem:
            if folder not in cells:
                unreadable.append((folder, str(problem)))
                continue
            run = Run(folder, "", "", 0, problem=str(problem))
        if folder in cells:
            row, scene, seed = cells[folder]
            run = replace(run, row=row, scene=scene, seed=seed)
        cell = (run.row, run.scene, run.seed)
        if cell in runs:
            raise ValueError(
                f"row {run.row}, scene {run.scene}, seed {run.seed} is in {runs[cell].folder} and in {folder}: "
                "expected one run folder per cell; list the folders of one table only"
            )
        runs[cell] = run
    return Collection(tuple(runs.values()), tuple(unreadable))


def read_run(folder: Path) -> Run:
    """Read one run folder. What is broken makes the run a failed one, as long as it says which cell it is.

    Raises :class:`BadRecord` where metrics.json is missing, no JSON, or names no row, scene and seed.
    """
    path = folder / "metrics.json"
    try:
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except (OSError, ValueError) as error:
        raise BadRecord(f"{path}: expected a JSON file, found: {error}") from error
    if not isinstance(data, dict):
        raise BadRecord(f"{path}: expected an object, found {type(data).__name__}")
    kinds = {"row": str, "scene": str, "seed": int}
    cell: dict[str, Any] = {key: _get(path, data, key, kind) for key, kind in kinds.items()}
    try:
        return _read_contents(folder, path, data, cell)
    except BadRecord as problem:
        return Run(folder, **cell, problem=str(problem))


def _read_contents(folder: Path, path: Path, data: dict[str, Any], cell: dict[str, Any]) -> Run:
    if data.get("schema") != SCHEMA:
        raise BadRecord(f"{path}: schema: expected {SCHEMA}, found {data.get('schema')!r}")
    status = _get(path, data, "status", str)
    if status not in ("ok", "failed"):
        raise BadRecord(f"{path}: status: expected ok or failed, found {status!r}")
    sees_truth = _get(path, data, "sees_truth", bool) if "sees_truth" in data else False
    if status == "failed":
        return Run(folder, **cell, problem=str(data.get("error") or "failed, no reason given"), sees_truth=sees_truth)

    groups, times = _get(path, data, "metrics", dict), _get(path, data, "time_s", dict)
    reasons = _get(path, data, "reasons", dict) if "reasons" in data else {}
    environment = _get(path, data, "environment", dict) if "environment" in data else {}
    commit, cpu = (str(environment[key]) if environment.get(key) else None for key in ("commit", "cpu"))
    metrics = {m.key: _number(path, _get(path, groups, m.component, dict), m.name, m.key) for m in METRICS}
    phases = [_number(path, times, key, f"time_s.{key}") for key in times if key not in ("total", "score")]
    try:
        curve, curve_problem = read_curve(folder / "curve.csv"), None
    except BadRecord as problem:
        curve, curve_problem = None, str(problem)
    return Run(
        folder,
        **cell,
        protocol=_get(path, data, "protocol", str),
        metrics=metrics,
        reasons={key: str(reason) for key, reason in reasons.items()},
        seconds=sum(seconds for seconds in phases if seconds is not None) if phases else None,
        peak_memory_bytes=_number(path, data, "peak_memory_bytes", "peak_memory_bytes"),
        commit=commit,
        cpu=cpu,
        sees_truth=sees_truth,
        curve=curve,
        curve_problem=curve_problem,
    )


def read_curve(path: Path) -> Curve | None:
    """Read a curve.csv; None where there is none. Raises :class:`BadRecord` naming file and line."""
    if not path.is_file():
        return None
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise BadRecord(f"{path}: expected a CSV file, found: {error}") from error
    columns = [metric.column for metric in CURVE_METRICS]
    table: dict[str, list[float]] = {name: [] for name in ("step", "seconds", *columns)}
    for number, line in enumerate(lines, start=2):  # line 1 is the header
        for name, cells in table.items():
            text = line.get(name)
            if text is None and name not in columns:
                raise BadRecord(f"{path}, line {number}: expected a column {name}, found {', '.join(map(str, line))}")
            try:
                cells.append(float(text) if text else math.nan)  # an empty cell was not measured
            except ValueError:
                raise BadRecord(f"{path}, line {number}, {name}: expected a number, found {text!r}") from None
    steps, seconds = np.array(table["step"]), np.array(table["seconds"])
    if not (np.isfinite(steps).all() and np.isfinite(seconds).all() and (np.diff(seconds) >= 0).all()):
        raise BadRecord(f"{path}: expected a step and rising seconds in every line")
    if not lines:
        return None
    stages = tuple(line.get("stage") or "" for line in lines)
    return Curve(stages, steps.astype(int), seconds, {name: np.array(table[name]) for name in columns})


def _get(path: Path, data: dict[str, Any], key: str, kind: type) -> Any:  # noqa: ANN401 (a value of that kind)
    value = data.get(key)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        found = "nothing" if key not in data else repr(value)
        raise BadRecord(f"{path}: {key}: expected {kind.__name__}, found {found}")
    return value


def _number(path: Path, data: dict[str, Any], key: str, name: str) -> float | None:
    value = data.get(key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise BadRecord(f"{path}: {name}: expected a number or null, found {value!r}")
    return value


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text}, which is no JSON number")
