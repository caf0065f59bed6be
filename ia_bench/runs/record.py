"""metrics.json: the one typed record of a run, which everything that writes or reads one goes through.

A new metric needs nothing here: ``metrics`` and ``variants`` hold whatever groups of numbers :mod:`ia_bench.scores` makes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ia_bench.common.declared import Declared
from ia_bench.common.errors import Fault, InputError
from ia_bench.common.files import read_json
from ia_bench.common.ranges import Name
from ia_bench.common.settings import parsed_file
from ia_bench.methods.monitor import NOT_OF_THE_ROW

METRICS_FILE = "metrics.json"
CONFIG = "config.json"
SCHEMA: Literal[2] = 2
CHANGED = "+changes"
"""What ends the commit of a checkout whose source differs from it (:func:`ia_bench.common.machine.commit`)."""
LACKING = ("the scene has no ", "the scene does not know ")
"""How reasons begin of a component that the scene has no truth of (:data:`ia_bench.scores.evaluate.NO_TRUTH`)."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
Group = dict[str, float | None]
PerView = dict[str, list[float | None]]


def row_seconds(time_s: Mapping[str, float]) -> float:
    """What a row took of the phases of ``time_s``: baking, asking the prior, fitting."""
    return sum(seconds for phase, seconds in time_s.items() if phase not in NOT_OF_THE_ROW)


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What a run leaves in numbers; a failed one has labels, ``error`` and whatever was known before.

    Attributes:
        row: Label in tables.
        scene: Name of the scene.
        seed: Of everything that is drawn.
        protocol: The protocol's label: numbers compare under one label.
        config_hash: SHA-256 of the run's identity.
        status: "ok" or "failed".
        preset: Name of the preset; None in records of before it was kept, as with the next.
        protocol_hash: SHA-256 of the protocol and the content of the scene's files.
        error: Why it failed, in one sentence.
        traceback: The same for developers.
        sees_truth: Whether prior or method saw the ground truth.
        protocol_description: Every number that decides a score.
        renderer: Who drew the pictures that were scored.
        metrics: Component -> metric -> mean; None where it is undefined.
        variants: The same under other definitions.
        per_image: Component (-> light) -> metric -> one value per view.
        reasons: Dotted name of a None -> why it is undefined.
        counts: Component -> numbers of views, pixels, clipped values.
        albedo_scales: Alignment -> RGB scale, None where there is none.
        geometry: A shape that was made for the run against the true one.
        time_s: Phase -> seconds, scoring and ``total`` included.
        cpu_seconds: What baking, prior and fit took of all cores; None on a GPU, and in records of before it was kept.
        load: When the fit was done, the programs that wanted each core of the machine; more than 1 where they waited for each
            other. None in records of before it was kept.
        peak_memory_bytes: Of the process.
        rays: Rays that were traced.
        network_calls: Images times evaluations of the prior's network.
        counters: Whatever else was counted.
        plan: What the method measured on the scene and decided by it.
        capture: What the scene was left with.
        environment: Machine, threads, versions and commit.
        files: Every other file that the run wrote -> its SHA-256.
        declared: What whoever brings results, or predictions, that were made elsewhere says of them; their seconds count in place
            of the run's own, which are among them where only predictions were brought. None for a run that has made all itself.
        rescored_from: Hash, protocol and commits of the run whose results are scored here again; empty for a run of its own.
    """

    __pydantic_config__ = ConfigDict(extra="ignore", allow_inf_nan=False)  # of a later version, which knows more

    schema: Literal[2] = SCHEMA
    row: Name
    scene: Name
    seed: Count
    protocol: str
    config_hash: str
    status: Literal["ok", "failed"]
    preset: str | None = None
    protocol_hash: str | None = None
    error: str = ""
    traceback: str | None = None
    sees_truth: bool = False
    protocol_description: dict[str, Any] = field(default_factory=dict)
    renderer: str = ""
    metrics: dict[str, Group] = field(default_factory=dict)
    variants: dict[str, Group] = field(default_factory=dict)
    per_image: dict[str, PerView | dict[str, PerView]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    albedo_scales: dict[str, list[float] | None] = field(default_factory=dict)
    geometry: dict[str, float | None | dict[str, str]] = field(default_factory=dict)
    time_s: dict[str, float] = field(default_factory=dict)
    cpu_seconds: Annotated[float, Field(ge=0)] | None = None
    load: Annotated[float, Field(ge=0)] | None = None
    peak_memory_bytes: Count = 0
    rays: Count = 0
    network_calls: Count = 0
    counters: dict[str, int | float] = field(default_factory=dict)
    plan: dict[str, Any] = field(default_factory=dict)
    capture: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    declared: Declared | None = None
    rescored_from: dict[str, str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise InputError for a finished run without scores, a failed one without a reason, and an undefined score without one."""
        if self.status == "failed" and not self.error:
            raise InputError("error: expected why the run failed, found nothing")
        if self.status == "ok" and not self.metrics:
            raise InputError("metrics: expected the scores of a finished run, found none")
        for kind, groups in (("metrics", self.metrics), ("variants", self.variants)):
            for name in (f"{group}.{name}" for group, values in groups.items() for name, value in values.items() if value is None):
                if not self.reasons.get(name):
                    raise InputError(f"{kind}.{name}: expected a number, or why there is none in reasons['{name}'], found neither")

    @classmethod
    def read(cls, folder: Path) -> RunRecord:
        """The record in a run's folder. Raises InputError where there is none, or something else."""
        path = folder / METRICS_FILE
        if not os.path.lexists(path):
            raise InputError(f"{folder}: expected a run's {METRICS_FILE}, found none")
        return parsed_file(cls, path, read_json(path), advice="; delete its folder to run again")

    def summary(self) -> str:
        """The means, one line per component, under the protocol that decides what they mean.

        Components of which nothing is defined come last, by name, in a line for each reason.
        """
        lines = [f"{self.row}, scene {self.scene}, seed {self.seed}, protocol {self.protocol}:"]
        unscored: dict[str, list[str]] = {}
        for component, values in self.metrics.items():
            if values and all(value is None for value in values.values()):
                said = dict.fromkeys(self.reasons[f"{component}.{name}"] for name in values)
                why = "no truth" if all(one.startswith(LACKING) for one in said) else "; ".join(said)
                unscored.setdefault(why, []).append(component)
                continue
            shown = [f"{name} {'undefined' if value is None else format(value, '.4g')}" for name, value in values.items()]
            lines.append(f"  {component:<16}{', '.join(shown)}")
        lines += [f"  not scored ({why}): {', '.join(components)}" for why, components in unscored.items()]
        return "\n".join(lines)

    @property
    def name(self) -> str:
        """How messages call the run."""
        return f"row {self.row}, scene {self.scene}, seed {self.seed}"

    @property
    def clean(self) -> bool | None:
        """Whether the code that made the run was a commit's, without changes; None where it was no checkout."""
        found = self.environment.get("commit")
        return not str(found).endswith(CHANGED) if found else None

    @property
    def threads(self) -> int | None:
        """CPU threads of the run, which decide its last digits; None where they were not recorded."""
        found = self.environment.get("threads")
        return found if type(found) is int else None

    def score(self, key: str) -> float | None:
        """A metric by its dotted name, "albedo.psnr"; None where it is undefined or was not measured."""
        component, _, name = key.rpartition(".")
        return self.metrics.get(component, {}).get(name)


@dataclass(frozen=True, kw_only=True)
class RunSetup:
    """config.json: what a run was asked for.

    Attributes:
        config_hash: SHA-256 of the identity.
        command: The command line that makes the run, as it was given, for a shell.
        config: The resolved configuration, with absolute paths.
        identity: What of it decides numbers, with hashes of files and code for paths (:func:`ia_bench.runs.identity.identity`).
    """

    config_hash: str
    command: str = ""
    config: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> RunSetup:
        """That of a run's folder. Raises InputError where there is none, or something else."""
        return parsed_file(cls, folder / CONFIG, read_json(folder / CONFIG), "expected the configuration of a run: ")


def finished_record(folder: Path, config_hash: str, note: Callable[[str], object] = lambda _: None) -> RunRecord | None:
    """The record in a run's folder if it is of this configuration, of no failure, and all its files are there. Takes no lock.

    None otherwise; ``note`` is told of the first file that is another one or gone.
    """
    if not os.path.lexists(folder / METRICS_FILE):
        return None
    record = RunRecord.read(folder)
    if record.status != "ok" or record.config_hash != config_hash:
        return None
    damaged = damaged_file(folder, record)
    if damaged is not None:
        note(f"{folder / damaged}: not what the run wrote there, or gone; running again")
    return record if damaged is None else None


def damaged_file(folder: Path, record: RunRecord) -> str | None:
    """The first of a finished run's files that is gone or is not what the run wrote; None if all are there."""
    return next((name for name, digest in record.files.items() if digest_of(folder / name) != digest), None)


def digest_of(path: Path) -> str | None:
    """SHA-256 (hex) of a file, None where there is no such file."""
    try:
        if not path.is_file():  # a pipe would never end
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def json_bytes(name: str, content: Mapping[str, Any]) -> bytes:
    """The content of the JSON file ``name``. Raises Fault for NaN, infinity and what is no type of JSON."""
    try:
        return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    except (TypeError, ValueError) as error:
        raise Fault(f"{name}: expected finite numbers, texts, lists and tables, found: {error}") from None
