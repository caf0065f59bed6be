"""All runs of a report as one table: a line per run, read from run folders and from the runs.csv of former reports.

Columns of :class:`Runs`, empty where a run has none (None for a text, NaN for a number):

    row, scene, seed        which cell of the table it is
    problem                 why it failed; None for a finished run
    protocol                what its numbers compare under, LPIPS net included
    sees_truth              whether prior or method saw the ground truth
    capture, photographs    the label of how the scene was photographed, and how many photographs the run fitted
    preset, threads         of its configuration
    command                 the settings of its command line, for a shell, without the folder that it was written into
    commit, clean, cpu      of the code and the machine; ``clean``: whether the code was the commit's, without changes
    config_hash             the first digits of it
    <component>_<metric>    a score, also under other definitions ("albedo_linear_psnr") and of a shape ("geometry_depth")
    seconds, seconds_PHASE  what the row costs, and every phase by itself
    cpu_seconds             the same in CPU seconds of all cores
    load                    how many programs wanted each core at that time
    declared, declared_...  "yes" where these seconds are what somebody says of results made elsewhere, and what else they say
    rescored_from_...       of a run that was scored again: hash, protocol and commits of the one whose results these are
    peak_memory_bytes, rays, network_calls
    folder                  where it lies; of a published run, the runs.csv
    reasons                 metric key -> why its score is undefined
    curve, curve_problem    error against run time, and why it cannot be read
    record, setup           what its folder holds of it; of a published run, nothing
"""

from __future__ import annotations

import math
import shlex
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from pandas.errors import ParserWarning

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.common.settings import parsed
from ia_bench.report.curves import read_curve
from ia_bench.runs.folder import CURVE
from ia_bench.runs.record import CHANGED, RunRecord, RunSetup, row_seconds
from ia_bench.scores.metrics import MEASURED, METRIC_OF

Runs: TypeAlias = pd.DataFrame
Record = dict[str, Any]
CellKey = tuple[str, str, int]  # row, scene, seed

HASH_DIGITS = 16
"""How many digits of a configuration's hash a report keeps: enough to tell any two runs apart, a quarter of the text."""
NOT_SCORED = "its record is of before this metric, or of a scene that has nothing of the kind"
"""Why a score is undefined that a run of a former version does not have."""

CELL = ("row", "scene", "seed")
MADE = ("preset", "command", "commit", "clean", "cpu", "config_hash")  # what says how a run was made
TEXTS = ("row", "scene", "problem", "protocol", "sees_truth", "capture", *MADE)
WHOLE = ("seed", "photographs", "threads", "peak_memory_bytes", "rays", "network_calls")
OF_A_FOLDER = ("folder", "curve", "curve_problem", "record", "setup")  # what no runs.csv holds
KEPT = (*OF_A_FOLDER, "reasons")  # never written
AGREEMENT = 1e-6  # of scores of one run in its folder and in a runs.csv, whose digits may have been cut
SCORES = tuple(metric.column for metric in MEASURED)
SPENT = ("seconds", "cpu_seconds", "load")
OF_RECORD = (*CELL, "sees_truth", "preset", "threads")  # columns that stand in every record by their names
COUNTED = ("cpu_seconds", "load", "peak_memory_bytes", "rays", "network_calls")  # the same of finished runs
TIMES, RESCORED = "seconds_", "rescored_from_"  # what the columns of phases, and of the run behind a new score, begin with
DECLARED = "declared"  # what the columns begin with that hold what is said of results made elsewhere


@dataclass(frozen=True)
class Collection:
    """All runs found, and why each file that is no run's record is none: of others, or torn."""

    runs: Runs
    unreadable: tuple[str, ...] = ()


def collect(folders: Iterable[Path] | Mapping[Path, CellKey | None], published: Iterable[Record] = ()) -> Collection:
    """Read the given run folders. A mapping says which cell each folder is for: its row may have been renamed since.

    None in its place: the folder's own record says so. ``published``: runs of former reports, which stand beside them; where the
    folder of one is there, too, that adds its curve, configuration and pictures.
    Raises InputError where two runs of the same row, scene and seed are there: neither would be the right one to show.
    """
    records, unreadable = [], []
    for folder in folders:
        cell = folders[folder] if isinstance(folders, Mapping) else None
        record = read_run(folder)
        if cell is not None:
            record |= dict(zip(CELL, cell, strict=True))
        if set(CELL) <= record.keys():
            records.append(record)
        else:
            unreadable.append(record["problem"])
    cells: dict[CellKey, Record] = {}
    joined: set[CellKey] = set()
    for record in (*records, *published):
        cell = record["row"], record["scene"], record["seed"]
        other = cells.get(cell)
        if other is None:
            cells[cell] = record
        elif cell not in joined and _publishes(record, other):
            cells[cell] = record | {name: other[name] for name in OF_A_FOLDER if name in other}
            joined.add(cell)
        else:
            found = f"row {cell[0]}, scene {cell[1]}, seed {cell[2]} is in {other['folder']} and in {record['folder']}"
            raise InputError(
                f"{found}: expected one run per cell; list the folders of one table only, or run the new row under another name "
                "with row=NAME"
            )
    return Collection(as_table(cells.values()), tuple(unreadable))


def _publishes(line: Record, run: Record) -> bool:
    """Whether a runs.csv's ``line`` is of the ``run`` of a folder, which then adds what no line holds: identity and scores agree.

    Not where one has failed and the other has not.
    """
    if "record" in line or "record" not in run or run["config_hash"] != line["config_hash"]:
        return False
    known = [(line[column], run.get(column)) for column in SCORES if line.get(column) is not None]
    agree = all(theirs is not None and math.isclose(ours, theirs, rel_tol=AGREEMENT) for ours, theirs in known)
    return agree and (run.get("problem") is None) == (line.get("problem") is None)


def as_table(records: Iterable[Record]) -> Runs:
    """The table of records, which may lack any column but those of the cell."""
    runs = pd.DataFrame(list(records), dtype=object)
    texts = [*TEXTS, *(name for name in runs if name.startswith((RESCORED, DECLARED)))]
    others = [name for name in runs if name not in {*texts, *WHOLE, *KEPT, *SCORES, *SPENT}]
    phases = [name for name in others if name.startswith(TIMES)]
    numbers = [*SCORES, *(name for name in others if name not in phases), *SPENT, *phases]
    runs = runs.reindex(columns=[*texts, *numbers, *WHOLE, *KEPT])
    runs = runs.astype(dict.fromkeys(numbers, float) | dict.fromkeys(WHOLE, "Int64"))
    named = [*texts, *KEPT]
    runs[named] = runs[named].astype(object).where(runs[named].notna(), None)
    return runs


def read_run(folder: Path) -> Record:
    """Read one run folder. A record that is broken makes the run a failed one without a cell."""
    try:
        record = RunRecord.read(folder)
    except InputError as error:
        return {"folder": folder, "problem": str(error)}
    environment, setup = record.environment, None
    with suppress(InputError):  # where it holds no configuration
        setup = RunSetup.read(folder)
    found = {
        "folder": folder,
        "record": record,
        "setup": setup,
        **{name: getattr(record, name) for name in OF_RECORD},
        "config_hash": record.config_hash[:HASH_DIGITS],
        "commit": made if isinstance(made := environment.get("commit"), str) else None,
        "clean": record.clean,
        "cpu": cpu if isinstance(cpu := environment.get("cpu"), str) else None,
    }
    with suppress(ValueError):  # quotes without an end, in somebody else's
        given = [] if setup is None else shlex.split(setup.command)[2:]
        found["command"] = shlex.join(text for text in given if not text.startswith("out=")) or None
    with suppress(InputError):  # of a former version
        found["capture"] = setup and parsed(CaptureSettings, setup.config.get("capture", {})).label
    if record.status == "failed":
        return {**found, "problem": record.error}
    shape = {name: value for name, value in record.geometry.items() if not isinstance(value, dict)}  # which "reasons" is
    variants: dict[str, dict[str, Any]] = {**record.variants, "geometry": shape}
    views, lpips = record.capture.get("views"), record.protocol_description.get("lpips")
    net = lpips.get("net", "unknown") if isinstance(lpips, dict) else "unknown"
    found |= {
        **{name: getattr(record, name) for name in COUNTED},
        "protocol": record.protocol if "lpips.net=" in record.protocol else f"{record.protocol} (lpips.net={net})",
        **{f"{group}_{name}": value for group, values in variants.items() for name, value in values.items()},
        **{metric.column: record.score(metric.key) for metric in MEASURED},
        **{f"{TIMES}{phase}": seconds for phase, seconds in record.time_s.items()},
        **{f"{RESCORED}{key}": value for key, value in record.rescored_from.items()},
        "seconds": row_seconds(record.time_s),
        "photographs": views if type(views) is int and views > 0 else None,
        "reasons": {**{metric.key: NOT_SCORED for metric in MEASURED if record.score(metric.key) is None}, **record.reasons},
    }
    if (said := record.declared) is not None:  # of results that were made elsewhere, whose seconds are none of this machine's
        found |= {"seconds": said.seconds, "cpu_seconds": None, "load": None, "peak_memory_bytes": None, DECLARED: "yes"}
        found |= {f"{DECLARED}_{key}": str(value) for key, value in vars(said).items() if value not in (None, "")}
    try:
        return {**found, "curve": read_curve(folder / CURVE)}
    except InputError as error:
        return {**found, "curve_problem": str(error)}


def read_published(path: Path) -> list[Record]:
    """The runs of a runs.csv, as a report of this or a former version wrote it. Curves and pictures are not in it.

    It needs a row, a scene, a seed and some score; columns that it lacks are empty, others are kept where they hold numbers. Raises
    InputError, naming file and line, for what is no value of its column.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", ParserWarning)
            lines = pd.read_csv(path, dtype=str, keep_default_na=False, index_col=False).to_dict("records")
    except (OSError, ValueError, ParserWarning) as error:  # of pandas, its own errors are among them
        raise InputError(f"{path}: expected a report's runs.csv, found: {shown(str(error))}") from error
    columns = set(lines[0]) if lines else set()
    missing = next((name for name in CELL if name not in columns), None)
    if missing is not None or columns.isdisjoint(SCORES):
        raise InputError(f"{path}: expected a report's runs.csv, found no column {missing or 'of a score'} or no line below it")
    return [{"folder": path, **_published(f"{path}, line {number}", line)} for number, line in enumerate(lines, start=2)]


def _published(where: str, line: Mapping[str, str]) -> Record:
    found: Record = {"sees_truth": False}
    for column, text in line.items():
        if text != "" and column not in ("status", "reason", "problem", *KEPT):
            value, expected = _value_of(column, text)
            if value is None and expected:
                raise InputError(f"{where}, {column}: expected {expected}, found {shown(repr(text))}")
            found |= {} if value is None else {column: value}
    status, reason = line.get("status", "ok"), line.get("reason", "")
    if not set(CELL) <= found.keys() or not (found["row"] + found["scene"]).isprintable():
        raise InputError(f"{where}: expected a row, a scene and a seed, found {shown(repr(dict(line)))}")
    if status not in ("ok", "failed"):
        raise InputError(f"{where}, status: expected ok or failed, found {shown(repr(status))}")
    if status == "failed":
        found["problem"] = reason or "failed"
    else:
        found.setdefault("protocol", "unknown")
    found["config_hash"] = found.get("config_hash", "")[:HASH_DIGITS] or None
    if found.get("commit"):
        found.setdefault("clean", not found["commit"].endswith(CHANGED))
    return found | {"reasons": {m.key: NOT_SCORED for m in MEASURED if not line.get(m.column)} | _reasons(reason)}


def _value_of(column: str, text: str) -> tuple[Any, str]:
    """The value of a text in a runs.csv, None where it is none, and what a column that has to hold one expects there."""
    if column in ("sees_truth", "clean"):
        return {"true": True, "false": False}.get(text.lower()), "true or false"
    if column in TEXTS or column.startswith((RESCORED, DECLARED)):
        return text, ""
    try:
        number = int(text) if column in WHOLE and text.lstrip("-").isdecimal() else float(text)
    except ValueError:
        number = math.nan
    if column in WHOLE:
        return int(number) if number % 1 == 0 and abs(number) < 2**63 else None, "a whole number below 2^63"
    return number if math.isfinite(number) else None, "a number" if column in (*SCORES, *SPENT) else ""


def name_of(run: Mapping[str, Any]) -> str:
    """How messages call a run."""
    return f"{run['row']}, {run['scene']}, seed {run['seed']}"


def reason_of(reasons: Mapping[str, str] | None, key: str) -> str:
    """Why the score ``key`` of a run is undefined, by its ``reasons``."""
    return (reasons or {}).get(key, "no reason given")


def finished(runs: Runs) -> Runs:
    """The runs that did not fail."""
    return runs[runs["problem"].isna()]


def reasons_text(run: Mapping[str, Any]) -> str:
    """Why scores of a run are undefined, as runs.csv has it: "key, key: why; key: why"."""
    keys: dict[str, list[str]] = {}
    for metric in MEASURED:
        why = reason_of(run["reasons"], metric.key)
        if np.isnan(run[metric.column]) and why != NOT_SCORED:
            keys.setdefault(why, []).append(metric.key)
    return "; ".join(f"{', '.join(mine)}: {reason}" for reason, mine in keys.items())


def _reasons(text: str) -> dict[str, str]:
    """What :func:`reasons_text` wrote; a reason may hold colons and semicolons of its own."""
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
