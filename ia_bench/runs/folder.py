"""The folder of one run: its configuration, checkpoint and results, safe against kill -9 and against a second process.

Nothing is read from a checkpoint whose checksum is another one, or that other code wrote: flipped bits would be resumed to other
numbers, and a state means what the code that wrote it meant. That is the code of this package, of which the file has a hash, and
of plugins, which is part of the configuration's hash (:func:`ia_bench.common.registry.foreign_code`).

Files: ``config.json`` (identity, its hash, and what it leaves out), ``checkpoint.pt`` while unfinished, ``curve.csv``,
whatever the run saves, and ``metrics.json``, written last. Every file is written beside its place and moved there, so a
reader sees the old one, the new one or none.
"""

from __future__ import annotations

import csv
import fcntl
import hashlib
import io
import os
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

from ia_bench.common.atomic_file import LEFTOVERS, whole_file
from ia_bench.common.errors import Fault, InputError, first_line, printable, raised
from ia_bench.common.paths import PACKAGE
from ia_bench.common.settings import parsed
from ia_bench.runs.interruption import end_if_asked
from ia_bench.runs.record import CONFIG, METRICS_FILE, RunRecord, RunSetup, digest_of, finished_record, json_bytes

CHECKPOINT = "checkpoint.pt"
CURVE = "curve.csv"
LOCK = ".lock"
MAGIC = b"ia_bench checkpoint\n"
DIGEST = 64  # characters of a SHA-256 in hex


class RunFolder:
    """The folder of one run, held under an exclusive lock between entering and leaving the ``with`` block."""

    def __init__(
        self,
        path: Path,
        identity: Mapping[str, Any],
        config_hash: str,
        note: Callable[[str], None] = print,
        setup: Mapping[str, Any] | None = None,
    ) -> None:
        """Make the folder if need be, wait for its lock, and claim it for this configuration.

        ``identity`` is what ``config_hash`` was computed from, ``setup`` what else :class:`RunSetup` keeps; ``note`` receives
        one-line messages. Raises InputError for a folder that holds another configuration's results (naming the keys that
        differ), or that cannot be written. One with nothing but a failed run is used again.
        """
        self.path, self.config_hash, self._note = path, config_hash, note
        self._written: set[str] = set()
        self._told_unsaved = False
        self.restoring = False
        """Whether a checkpoint was handed out and nobody has gone on from it yet: what fails now is the checkpoint's fault."""
        self._lock = lock_folder(path, note)
        try:
            self._claim(identity, setup or {})
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> RunFolder:
        """Return this folder."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self._lock.close()

    def finished(self) -> RunRecord | None:
        """The record of this run if it has already finished and all its files are there, else None (also after a failure)."""
        return finished_record(self.path, self.config_hash, self._note)

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Write a checkpoint of tensors, numbers, texts, lists and dicts, durable once this returns.

        A disk that cannot take it costs what an interruption would lose, not the run: that is said once. A run that was
        asked to end does so here.
        """
        path = self.path / CHECKPOINT
        try:
            with whole_file(path) as temporary:
                temporary.write_bytes(pack(state, self.config_hash))
        except OSError as error:
            if not self._told_unsaved:
                self._note(f"{path}: cannot be written ({error.strerror}); an interruption would cost more than usual")
            self._told_unsaved = True
        end_if_asked()

    def load_checkpoint(self) -> dict[str, Any] | None:
        """The last checkpoint, or None. One that is not whole is reported and ignored: the run starts over."""
        path = self.path / CHECKPOINT
        if not os.path.lexists(path):
            return None
        try:
            state = unpack(path, self.config_hash)
        except Exception as error:  # torch.load raises whatever a file leads it to
            self._note(f"{path}: checkpoint ignored, starting over ({first_line(error)})")
            return None
        self.restoring = True
        return state

    def drop_checkpoint(self) -> None:
        """Remove the checkpoint."""
        self.restoring = False
        with suppress(OSError):  # of a folder, say, which is nobody's checkpoint
            (self.path / CHECKPOINT).unlink(missing_ok=True)

    @contextmanager
    def path_for(self, name: str) -> Iterator[Path]:
        """A temporary path to write to; it becomes the file ``name`` when the block ends without an exception.

        Raises Fault where it cannot be written; what was there before stays.
        """
        try:
            with whole_file(self.path / name) as temporary:
                yield temporary
        except OSError as error:
            raise Fault(f"{self.path / name}: cannot be written ({error.strerror or error})") from error
        self._written.add(name)

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a file at once or not at all."""
        with self.path_for(name) as temporary:
            temporary.write_bytes(content)

    def write_curve(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write error against run time: one row per evaluation, columns ``stage, step, seconds``, then the metrics.

        An undefined value (None) leaves its cell empty.
        """
        columns = list(dict.fromkeys([*("stage", "step", "seconds"), *(key for row in rows for key in row)]))
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        self.write_bytes(CURVE, text.getvalue().encode())

    def write_record(self, record: RunRecord) -> RunRecord:
        """Write metrics.json and return what it holds; a finished run needs its checkpoint no longer.

        ``files`` becomes the checksum of every file that this process wrote. Raises Fault for what is no record.
        """
        record = replace(record, config_hash=self.config_hash)
        if record.status == "ok":
            files = sorted(self._written - {CONFIG, METRICS_FILE})
            record = replace(record, files={name: digest_of(self.path / name) or "" for name in files})
        try:
            parsed(RunRecord, content := asdict(record))
        except InputError as error:
            raise Fault(f"{METRICS_FILE}: {error}") from None
        self.write_bytes(METRICS_FILE, json_bytes(METRICS_FILE, content))
        if record.status == "ok":
            self.drop_checkpoint()
        return record

    def write_failure(self, failure: BaseException | str, known: Mapping[str, Any]) -> None:
        """Write the record of a failed run, which the next run tries again; ``known``: labels, and whatever else of it is known."""
        error = printable(str(failure) if isinstance(failure, Fault | InputError | str) else raised(failure))
        trace = None if isinstance(failure, str) else "".join(traceback.format_exception(failure))
        trace = trace and trace.encode(errors="backslashreplace").decode()
        self.write_record(RunRecord(**known, error=error, traceback=trace, config_hash=self.config_hash, status="failed"))

    def forget(self) -> bool:
        """Remove the folder, and the one around it, if that is empty then; False where it holds more than a configuration."""
        if {path.name for path in self.path.iterdir()} != {CONFIG, LOCK}:
            return False
        with suppress(OSError):
            for name in (CONFIG, LOCK):
                (self.path / name).unlink()
            self.path.rmdir()
            self.path.parent.rmdir()
        return True

    def _claim(self, identity: Mapping[str, Any], setup: Mapping[str, Any]) -> None:
        path = self.path / CONFIG
        held = RunSetup.read(self.path) if path.exists() else None
        if held is None and (self.path / METRICS_FILE).exists():
            raise InputError(f"{self.path}: holds a {METRICS_FILE} but no {CONFIG}, so it is not a run's folder")
        another = held is not None and held.config_hash != self.config_hash
        if held is not None and another:
            if not (self.path / METRICS_FILE).exists() or RunRecord.read(self.path).status != "failed":
                keys = ", ".join(_differing(held.identity, identity)) or "the version of the code"
                raise InputError(f"{self.path}: holds the results of another configuration; these differ: {keys}")
            self.drop_checkpoint()
        # A run that goes on, or is tried again, may have its files elsewhere by now, and another name.
        if finished_record(self.path, self.config_hash) is None:
            content = {"config_hash": self.config_hash, **setup, "identity": dict(identity)}
            self.write_bytes(CONFIG, json_bytes(CONFIG, content))
        if another:  # now: with its own configuration and no failure, a run that was killed here would be used by nobody else
            (self.path / METRICS_FILE).unlink()
        for leftover in self.path.glob(LEFTOVERS):  # of a process that was killed while writing
            with suppress(OSError):  # a folder is somebody else's
                leftover.unlink()


def lock_folder(path: Path, note: Callable[[str], None]) -> BinaryIO:
    """Make the folder if need be, wait until no other process holds it, and return the file that holds it now.

    Closing the file lets go. It stays in the folder, so that nobody can lock a file that is already gone; it is neither
    written nor emptied, and not followed where it is a symbolic link. Its time is when it was locked last (:func:`held_since`).
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = os.fdopen(os.open(path / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be used as a run's folder ({error.strerror})") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        note(f"{path}: another process is working on this run; waiting for it to finish")
        fcntl.flock(lock, fcntl.LOCK_EX)
    except OSError as error:
        lock.close()
        raise InputError(f"{path}: expected a file system on which files can be locked, found: {error.strerror}") from None
    with suppress(OSError):  # a file system that keeps no times
        os.utime(lock.fileno())
    return lock


def held_since(path: Path) -> float | None:
    """Since when a process has been working in a run's folder, in seconds of the clock; None where none is.

    Nothing is made or changed; a process that begins just now waits for a moment.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK  # the last of a pipe in its place
    with suppress(OSError), os.fdopen(os.open(path / LOCK, flags), "rb") as lock:  # else never locked
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return os.fstat(lock.fileno()).st_mtime
    return None


def recorded_at(path: Path) -> int:
    """When a run's record was written, in ns; 0 if it never was."""
    try:
        return (path / METRICS_FILE).stat().st_mtime_ns
    except OSError:
        return 0


def find_run_folders(*roots: Path) -> list[Path]:
    """Every folder below ``roots`` that holds a metrics.json, or the config.json of a run that has not finished, sorted."""
    recorded = {path.parent for root in roots for path in root.rglob(METRICS_FILE)}
    found = set(recorded)
    for folder in {path.parent for root in roots for path in root.rglob(CONFIG)} - recorded:
        with suppress(InputError):  # weights have a config.json too
            RunSetup.read(folder)
            found.add(folder)
    return sorted(found)


def _differing(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Each dotted key whose value differs, with both values."""
    for key in dict.fromkeys([*old, *new]):
        before, after = old.get(key), new.get(key)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            yield from _differing(before, after, f"{prefix}{key}.")
        elif before != after:
            yield f"{prefix}{key} ({before} there, {after} here)"


def pack(state: dict[str, Any], config_hash: str) -> bytes:
    """The content of a checkpoint file. ``state``: tensors, numbers, texts, lists and dicts."""
    import torch  # readers of results do without it

    buffer = io.BytesIO()
    torch.save({"code": _code(), "config_hash": config_hash, "state": state}, buffer)
    return MAGIC + hashlib.sha256(buffer.getbuffer()).hexdigest().encode() + buffer.getbuffer()


def unpack(path: Path, config_hash: str) -> dict[str, Any]:
    """The state in a checkpoint file. Raises ValueError for one that is damaged, of another configuration or of other code."""
    import torch

    content, start = path.read_bytes(), len(MAGIC) + DIGEST
    if content[:start] != MAGIC + hashlib.sha256(memoryview(content)[start:]).hexdigest().encode():
        raise ValueError("it is damaged")
    saved = torch.load(io.BytesIO(content[start:]), map_location="cpu", weights_only=True)
    if saved["code"] != _code() or saved["config_hash"] != config_hash:
        raise ValueError("another version of the code wrote it, or it belongs to another configuration")
    return dict(saved["state"])


@cache
def _code() -> str:
    """Which code writes: a hash of the package's sources, and torch's version."""
    import torch

    digest = hashlib.sha256(torch.__version__.encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
