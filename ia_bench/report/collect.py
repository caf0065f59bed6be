"""Read run folders: metrics.json and curve.csv, nothing else. What cannot be read is named and counts as a failure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.runs.record import METRICS_FILE, RunRecord
from ia_bench.scores.columns import CURVE_METRICS, METRICS

HASH_DIGITS = 16
"""Of a configuration's hash that a report keeps: enough to tell any two runs apart, a quarter of the text."""
NOT_OF_THE_ROW = ("total", "score", "pictures", "capture")
"""Phases that are no cost of a row. The scene's preparation, ``capture``, is the same for all rows and kept between runs: it would
count for whichever row happened to come first."""

BOUNDS = {"ceiling": "ceiling", "constant": "floor"}
"""Methods that optimise nothing and bound all others, and what they are: the truth rendered, and one grey."""

CellKey = tuple[str, str, int]  # row, scene, seed


class BadRecord(ValueError):
    """A file of a run folder is not what the format says."""


@dataclass(frozen=True)
class Curve:
    """Error against run time.

    Attributes:
        phases: The method's phase at each point, (N,).
        steps: Of optimisation, (N,).
        seconds: Of optimisation without scoring, (N,).
        values: Column of curve.csv -> (N,) float64, NaN where not measured.
    """

    phases: tuple[str, ...]
    steps: np.ndarray
    seconds: np.ndarray
    values: dict[str, np.ndarray]

    @property
    def is_level(self) -> bool:
        """Whether nothing was optimised, as of the bounds: a level, not a curve."""
        return not (self.steps.any() and self.seconds.any())

    def measured(self, column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steps, seconds and values of one column where it has a finite value."""
        values = self.values.get(column, np.full(len(self.steps), np.nan))
        there = np.isfinite(values)
        return self.steps[there], self.seconds[there], values[there]


@dataclass(frozen=True)
class Run:
    """One cell of the table, as its folder records it.

    Attributes:
        folder: Where it lies; of a published run, the runs.csv.
        row: Which row of the table it belongs to.
        scene: The scene's name.
        seed: The seed of everything that is drawn.
        problem: Why it failed, None for a finished run.
        protocol: What its numbers compare under, LPIPS net included; None for a failed run.
        metrics: :attr:`Metric.key` -> value, None where null.
        variants: The same under other definitions, such as "aligned_albedo_linear.psnr", and of a shape that was made for the
            capture, such as "geometry.missed_share": whatever was recorded.
        reasons: Dotted name -> why a value is null.
        phases: Phase -> seconds, scoring and total included.
        seconds: Of all phases but ``NOT_OF_THE_ROW``, also where a run was interrupted or samples were kept; of a published run,
            as its runs.csv has it.
        peak_memory_bytes: Of the process.
        about: What else runs.csv has, by column: rays, network calls, commit, processor, hash.
        sees_truth: Whether prior or method saw the ground truth.
        photographs: How many the run fitted, None where its record does not say.
        curve: Error against run time, None where there is none or ``curve_problem`` says why it cannot be read.
    """

    folder: Path
    row: str
    scene: str
    seed: int
    problem: str | None = None
    protocol: str | None = None
    metrics: dict[str, float | None] = field(default_factory=dict)
    variants: dict[str, float | None] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    phases: dict[str, float] = field(default_factory=dict)
    seconds: float | None = None
    peak_memory_bytes: float | None = None
    about: dict[str, Any] = field(default_factory=dict)
    sees_truth: bool = False
    photographs: int | None = None
    curve: Curve | None = None
    curve_problem: str | None = None

    @property
    def name(self) -> str:
        """How messages call this run."""
        return f"{self.row}, {self.scene}, seed {self.seed}"

    def reason(self, key: str) -> str:
        """Why the metric ``key`` is null."""
        return self.reasons.get(key, "no reason given")


@dataclass(frozen=True)
class Collection:
    """All runs found, and why each file that is no run's record is none: of others, or torn."""

    runs: tuple[Run, ...]
    unreadable: tuple[str, ...] = ()


def collect(folders: Iterable[Path] | Mapping[Path, CellKey | None], published: Iterable[Run] = ()) -> Collection:
    """Read the given run folders. A mapping says which cell each folder is for: its row may have been renamed since.

    None in its place: the folder's own record says so.
    ``published``: runs of former reports, which stand beside them. Raises ValueError where the same row, scene and seed are there
    twice: neither would be the right one to show.
    """
    cells = {folder: cell for folder, cell in folders.items() if cell is not None} if isinstance(folders, Mapping) else {}
    runs: dict[CellKey, Run] = {}
    unreadable = []

    def add(run: Run) -> None:
        cell = (run.row, run.scene, run.seed)
        if cell in runs:
            raise ValueError(
                f"row {run.row}, scene {run.scene}, seed {run.seed} is in {runs[cell].folder} and in {run.folder}: "
                "expected one run per cell; list the folders of one table only"
            )
        runs[cell] = run

    for folder in folders:
        try:
            run = read_run(folder)
        except BadRecord as problem:
            if folder not in cells:
                unreadable.append(str(problem))
                continue
            run = Run(folder, "", "", 0, problem=str(problem))
        if folder in cells:
            row, scene, seed = cells[folder]
            run = replace(run, row=row, scene=scene, seed=seed)
        add(run)
    for run in published:
        add(run)
    return Collection(tuple(runs.values()), tuple(unreadable))


def read_run(folder: Path) -> Run:
    """Read one run folder. What is broken makes the run a failed one, as long as it says which cell it is.

    Raises :class:`BadRecord` where metrics.json is missing, no JSON, or names no row, scene and seed.
    """
    path = folder / METRICS_FILE
    try:
        data = read_json(path)
    except InputError as error:
        raise BadRecord(f"{path}: expected a run's record, found none ({error})") from error
    for key, kind in {"row": str, "scene": str, "seed": int}.items():
        if type(data.get(key)) is not kind:
            raise BadRecord(f"{path}: {key}: expected {kind.__name__}, found {repr(data[key]) if key in data else 'nothing'}")
    run = Run(folder, data["row"], data["scene"], data["seed"])
    try:
        record = RunRecord.read(folder)
    except InputError as error:
        return replace(run, problem=str(error))
    data = asdict(record)
    about = {"config_hash": data["config_hash"][:HASH_DIGITS]}
    if data["status"] == "failed":
        return replace(run, problem=data["error"], sees_truth=bool(data.get("sees_truth")), about=about)
    try:
        curve, curve_problem = read_curve(folder / "curve.csv"), None
    except BadRecord as error:
        curve, curve_problem = None, str(error)
    about |= {key: data[key] for key in ("rays", "network_calls")} | {
        key: (data["environment"] or {}).get(key) for key in ("commit", "cpu")
    }
    shape = {name: value for name, value in (data.get("geometry") or {}).items() if name != "reasons"}
    variants = {**data.get("variants", {}), **({"geometry": shape} if shape else {})}
    about |= {f"rescored_from_{key}": value for key, value in data.get("rescored_from", {}).items()}
    return replace(
        run,
        protocol=_protocol_text(data),
        metrics={metric.key: record.score(metric.key) for metric in METRICS},
        variants={f"{group}.{name}": value for group, found in variants.items() for name, value in found.items()},
        reasons=data.get("reasons", {}),
        phases=data["time_s"],
        seconds=sum(seconds for phase, seconds in data["time_s"].items() if phase not in NOT_OF_THE_ROW),
        peak_memory_bytes=data["peak_memory_bytes"],
        about=about,
        sees_truth=data["sees_truth"],
        photographs=_photographs(data.get("capture")),
        curve=curve,
        curve_problem=curve_problem,
    )


def _photographs(capture: object) -> int | None:
    views = capture.get("views") if isinstance(capture, Mapping) else None
    return views if type(views) is int and views > 0 else None


def _protocol_text(data: Mapping[str, Any]) -> str:
    """The protocol's label, with the LPIPS net where that does not name it."""
    lpips = data.get("protocol_description", {}).get("lpips", {})
    net, label = f"lpips.net={lpips.get('net', 'unknown')}", str(data["protocol"])
    return label if "lpips.net=" in label else f"{label} ({net})"


def read_curve(path: Path) -> Curve | None:
    """Read a curve.csv; None where there is none. Raises :class:`BadRecord` naming file and line."""
    if not path.is_file():
        return None
    try:
        texts = pd.read_csv(path, dtype=str)
    except (OSError, ValueError) as error:  # of pandas, its own errors are among them
        raise BadRecord(f"{path}: expected a CSV file, found: {error}") from error
    missing = next((name for name in ("step", "seconds") if name not in texts), None)
    if missing is not None:
        raise BadRecord(f"{path}: expected a column {missing}, found {', '.join(texts.columns)}")
    columns = [metric.column for metric in CURVE_METRICS]
    numbers = texts.reindex(columns=["step", "seconds", *columns]).apply(pd.to_numeric, errors="coerce")
    for name in numbers:
        wrong = texts.index[numbers[name].isna() & texts[name].notna()] if name in texts else []
        if len(wrong):  # line 1 is the header
            raise BadRecord(f"{path}, line {wrong[0] + 2}, {name}: expected a number, found {texts[name][wrong[0]]!r}")
    steps, seconds = numbers["step"].to_numpy(float), numbers["seconds"].to_numpy(float)
    if not (np.isfinite(steps).all() and np.isfinite(seconds).all() and (np.diff(seconds) >= 0).all()):
        raise BadRecord(f"{path}: expected a step and rising seconds in every line")
    phase = next((name for name in ("phase", "stage") if name in texts), None)
    phases = tuple(texts[phase].fillna("")) if phase else ("",) * len(texts)
    values = {name: numbers[name].to_numpy(float) for name in columns}
    return Curve(phases, steps.astype(int), seconds, values) if len(texts) else None
