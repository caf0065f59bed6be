"""The folder of one run: its configuration, checkpoint and results, safe against kill -9 and against a second process.

Files: ``config.json`` (identity and hash), ``checkpoint.pt`` while unfinished, ``curve.csv``, whatever the run saves,
and ``metrics.json``, written last. Every file is written beside its place and moved there, so a reader sees the old
one, the new one or none.
"""

from __future__ import annotations

import csv
import fcntl
import io
import json
import math
import os
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from ia_bench.common.errors import InputError

METRICS = "metrics.json"
CONFIG = "config.json"
CHECKPOINT = "checkpoint.pt"
CHECKPOINT_FORMAT = 2  # raised when a change of the code changes what a checkpoint holds
CURVE = "curve.csv"
SCHEMA = 1

METRICS_KEYS: dict[str, type] = {
    "schema": int,
    "row": str,
    "scene": str,
    "seed": int,
    "protocol": str,
    "config_hash": str,
    "status": str,
    "metrics": dict,
    "per_image": dict,
    "time_s": dict,
    "peak_memory_bytes": int,
    "rays": int,
    "network_calls": int,
    "plan": dict,
    "environment": dict,
}
"""Keys that metrics.json of a finished run must have, and their types. More keys are allowed."""

FAILED_KEYS = ("schema", "row", "scene", "seed", "protocol", "config_hash", "status")
"""The keys that a failed run still has, besides ``error``."""


class RecordError(ValueError):
    """A result that must not be written: a missing key, a wrong type, NaN or infinity."""


class RunFolder:
    """The folder of one run, held under an exclusive lock between entering and leaving the ``with`` block."""

    def __init__(self, path: Path, config_hash: str, lock: TextIO, note: Callable[[str], None]) -> None:
        """Use :meth:`open`."""
        self.path = path
        self.config_hash = config_hash
        self._lock = lock
        self._note = note

    @classmethod
    def open(
        cls, path: Path, config: Mapping[str, Any], config_hash: str, note: Callable[[str], None] = print
    ) -> RunFolder:
        """Make the folder if need be, wait for its lock, and claim it for this configuration.

        ``config`` is what ``config_hash`` was computed from; ``note`` receives one-line messages. Raises InputError for
        a folder that holds another configuration's results (naming the keys that differ), or that cannot be written.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = (path / ".lock").open("w")
        except OSError as error:
            raise InputError(f"{path}: cannot be used as a run's folder ({error.strerror})") from None
        try:
            _acquire(lock, path, note)
            folder = cls(path, config_hash, lock, note)
            folder._claim(config)
        except BaseException:
            lock.close()
            raise
        return folder

    def __enter__(self) -> RunFolder:
        """Return this folder."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the lock; the file stays, so that nobody can lock a file that is already gone."""
        self._lock.close()

    def finished(self) -> dict[str, Any] | None:
        """The metrics of this run if it has already finished, else None (also after a failure)."""
        return finished_metrics(self.path, self.config_hash)

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Write a checkpoint of tensors, numbers, texts, lists and dicts, durable once this returns."""
        import torch  # readers of results do without it

        with self.path_for(CHECKPOINT) as temporary, temporary.open("wb") as file:
            torch.save({"format": CHECKPOINT_FORMAT, "config_hash": self.config_hash, "state": state}, file)

    def load_checkpoint(self) -> dict[str, Any] | None:
        """The last checkpoint, or None. One that cannot be read is reported and ignored: the run starts over."""
        import torch

        path = self.path / CHECKPOINT
        if not path.exists():
            return None
        try:
            saved = torch.load(path, map_location="cpu", weights_only=True)
            if saved["config_hash"] != self.config_hash:
                reason = "it belongs to another configuration"
            elif saved.get("format") != CHECKPOINT_FORMAT:
                reason = "another version of the code wrote it"
            else:
                state: dict[str, Any] = saved["state"]
                return state
        except Exception as error:  # torch.load raises whatever a damaged file leads it to
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        self._note(f"{path}: checkpoint ignored, starting over ({reason})")
        return None

    @contextmanager
    def path_for(self, name: str) -> Iterator[Path]:
        """A temporary path to write to; it becomes the file ``name`` when the block ends without an exception.

        >>> with folder.path_for("albedo.exr") as path:  # doctest: +SKIP
        ...     write_exr(path, albedo)
        """
        target = self.path / name
        temporary = target.with_name(f".tmp-{target.name}")  # one writer at a time: the folder is locked
        try:
            yield temporary
            with temporary.open("rb") as written:
                os.fsync(written.fileno())
            os.replace(temporary, target)
            _sync_folder(target.parent)
        finally:
            temporary.unlink(missing_ok=True)

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a file at once or not at all."""
        with self.path_for(name) as temporary:
            temporary.write_bytes(content)

    def write_json(self, name: str, content: Any) -> None:  # noqa: ANN401 (any JSON value)
        """Write JSON. Raises RecordError naming the first key that holds NaN, infinity or no JSON type."""
        self.write_bytes(name, _json_bytes(content, name))

    def write_curve(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write error against run time: one row per evaluation, columns ``stage, step, seconds``, then the metrics.

        An undefined value (None) leaves its cell empty. Raises RecordError for NaN or infinity.
        """
        columns = list(dict.fromkeys([*("stage", "step", "seconds"), *(key for row in rows for key in row)]))
        for number, row in enumerate(rows):
            _refuse_non_finite(row, f"{CURVE}[{number}]")
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        self.write_bytes(CURVE, text.getvalue().encode())

    def write_metrics(self, metrics: Mapping[str, Any]) -> None:
        """Write metrics.json, after which the run is finished; the checkpoint is then no longer needed.

        Raises RecordError where the schema of metrics.json is not met: a key missing or of the wrong type, another
        configuration's hash, NaN or infinity, or a null without an entry in ``reasons``.
        """
        check_metrics(metrics)
        if metrics["config_hash"] != self.config_hash:
            raise RecordError(f"config_hash: expected {self.config_hash}, found {metrics['config_hash']}")
        self.write_json(METRICS, metrics)
        if metrics["status"] == "ok":
            (self.path / CHECKPOINT).unlink(missing_ok=True)

    def write_failure(self, failure: BaseException | str, labels: Mapping[str, Any]) -> None:
        """Write a metrics.json with status "failed" and what went wrong as ``error``; the next run tries again.

        ``labels``: row, scene, seed and protocol, as in the metrics of a finished run.
        """
        if isinstance(failure, BaseException):
            problem = f"{type(failure).__name__}: {failure}"
            trace = "".join(traceback.format_exception(failure))
        else:
            problem, trace = failure, None
        record = {"schema": SCHEMA, **labels, "config_hash": self.config_hash, "status": "failed", "error": problem}
        self.write_metrics({**record, "traceback": trace, "metrics": {}})

    def _claim(self, config: Mapping[str, Any]) -> None:
        path = self.path / CONFIG
        if path.exists():
            held = _read_object(path)
            if not isinstance(held.get("config_hash"), str) or not isinstance(held.get("config"), dict):
                raise InputError(f"{path}: expected a run's config_hash and config, found {', '.join(held) or 'nothing'}")
            if held["config_hash"] != self.config_hash:
                keys = ", ".join(_differing(held["config"], config))
                raise InputError(f"{self.path}: holds the results of another configuration; these differ: {keys}")
        elif (self.path / METRICS).exists():
            raise InputError(f"{self.path}: holds a {METRICS} but no {CONFIG}, so it is not a run's folder")
        else:
            self.write_json(CONFIG, {"config_hash": self.config_hash, "config": dict(config)})
        for leftover in self.path.glob(".tmp-*"):  # of a process that was killed while writing
            leftover.unlink()


def finished_metrics(path: Path, config_hash: str) -> dict[str, Any] | None:
    """The metrics in a run's folder if they are of this configuration and of no failure, else None. Takes no lock."""
    try:
        metrics = _read_object(path / METRICS)
    except FileNotFoundError:
        return None
    return metrics if metrics.get("status") == "ok" and metrics.get("config_hash") == config_hash else None


def _read_object(path: Path) -> dict[str, Any]:
    """A JSON object. Raises FileNotFoundError, and InputError for what is something else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:  # no JSON, or no text
        raise InputError(f"{path}: not valid JSON ({error}); delete its folder to run again") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(content).__name__}; delete its folder to run again")
    return content


def check_metrics(metrics: Mapping[str, Any]) -> None:
    """Raise RecordError naming the first key of metrics.json that is missing, of the wrong type or null unexplained.

    ``reasons`` explains every null by its dotted name: ``{"albedo.psnr": "no scored pixel"}``.
    """
    status = metrics.get("status")
    if status not in ("ok", "failed"):
        raise RecordError(f"status: expected 'ok' or 'failed', found {status!r}")
    required = METRICS_KEYS if status == "ok" else {key: METRICS_KEYS[key] for key in FAILED_KEYS} | {"error": str}
    reasons = metrics.get("reasons", {})
    for key, kind in required.items():
        if key not in metrics:
            raise RecordError(f"{key}: missing")
        value = metrics[key]
        if value is None and reasons.get(key):
            continue
        if not isinstance(value, kind) or isinstance(value, bool):
            raise RecordError(f"{key}: expected {kind.__name__}, found {value!r}")
    if metrics["schema"] != SCHEMA:
        raise RecordError(f"schema: expected {SCHEMA}, found {metrics['schema']}")
    _check_values(metrics.get("metrics", {}), "", reasons)


def _check_values(group: Mapping[str, Any], prefix: str, reasons: Mapping[str, str]) -> None:
    """Metrics are numbers in named groups; an undefined one is None, with its reason under its dotted name."""
    for key, value in group.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            _check_values(value, f"{name}.", reasons)
        elif value is None:
            if not reasons.get(name):
                raise RecordError(f"metrics.{name}: is null without a reason; say why in reasons['{name}']")
        elif not isinstance(value, int | float) or isinstance(value, bool):
            raise RecordError(f"metrics.{name}: expected a number, found {value!r}")


def _json_bytes(content: Any, name: str) -> bytes:  # noqa: ANN401 (any JSON value)
    _refuse_non_finite(content, name)
    try:
        return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    except TypeError as error:
        raise RecordError(f"{name}: {error}") from None


def _refuse_non_finite(value: Any, where: str) -> None:  # noqa: ANN401 (any JSON value)
    if isinstance(value, float) and not math.isfinite(value):
        raise RecordError(f"{where}: is {value}; an undefined value is null with a reason")
    if isinstance(value, Mapping):
        for key, item in value.items():
            _refuse_non_finite(item, f"{where}: {key}" if ": " not in where else f"{where}.{key}")
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            _refuse_non_finite(item, f"{where}[{number}]")


def _differing(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Each dotted key whose value differs, with both values."""
    for key in dict.fromkeys([*old, *new]):
        before, after = old.get(key), new.get(key)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            yield from _differing(before, after, f"{prefix}{key}.")
        elif before != after:
            yield f"{prefix}{key} ({before} there, {after} here)"


def _acquire(lock: TextIO, path: Path, note: Callable[[str], None]) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        note(f"{path}: another process is working on this run; waiting for it to finish")
        fcntl.flock(lock, fcntl.LOCK_EX)


def _sync_folder(folder: Path) -> None:
    """Make a rename durable: on Linux the folder's entry is a write of its own."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
