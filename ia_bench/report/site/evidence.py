"""Where a number comes from: the command that makes its run, its configuration, hashes, machine and commit."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.settings import flat
from ia_bench.report.collect import HASH_DIGITS, Run
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.identity import identity
from ia_bench.runs.record import METRICS_FILE
from ia_bench.scores.protocol import ComparisonSettings, Protocol, SsimSettings, shipped

Settings = dict[str, Any]
"""Dotted name -> value, a JSON type."""

SETTABLE = (
    *("render.", "method.options.", "prior.options.", "prior.views", "coupling.", "reader.options.", "capture."),
    *("device", "threads"),
)
"""What begins the names that a command line may set, of those that decide a run; the protocol's are :data:`PROTOCOL`."""
DIGITS = 12  # of a file's checksum
CONSISTENCY_KEY, HASHED = "consistency_version", "content "
MACHINE = ("cpu", "cores", "threads", "device", "system", "python", "commit")


@dataclass(frozen=True)
class Evidence:
    """What a run folder says of how its numbers came about.

    Attributes:
        settings: The configuration, flat; empty where the folder holds none.
        given: The paths of that whose content it names, by the same names.
        environment: Machine, versions and commit, flat.
        files: Name -> the first digits of the SHA-256 of what the run wrote.
        renderer: Who drew the pictures that were scored.
    """

    settings: Settings = field(default_factory=dict)
    given: Mapping[str, str] = field(default_factory=dict)
    environment: Settings = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    renderer: str = ""


def evidence_of(run: Run) -> Evidence:
    """Read the run's folder again; what it lacks is left empty, as of a run that only a runs.csv knows."""
    config, metrics = _read(run.folder / CONFIG), _read(run.folder / METRICS_FILE)
    if metrics.get("row") != run.row and str(metrics.get("config_hash"))[:HASH_DIGITS] != run.about.get("config_hash"):
        config, metrics = {}, {}  # the folder is that of a report, not of this run
    environment = metrics.get("environment", {})
    machine = {key: environment[key] for key in MACHINE if environment.get(key) is not None}
    versions = {f"packages.{name}": version for name, version in environment.get("packages", {}).items() if version}
    return Evidence(
        settings=flat(config.get("config", {})),
        given=config.get("given", {}),
        environment=machine | versions,
        files={name: digest[:DIGITS] for name, digest in metrics.get("files", {}).items()},
        renderer=str(metrics.get("renderer", "")),
    )


LEFT_OUT = {
    **flat(asdict(CaptureSettings()), "capture."),
    **flat(asdict(ComparisonSettings()), "protocol.comparison."),
    "protocol.ssim.side": None,
    "protocol.ssim.border": SsimSettings.border,
}
"""What a run's identity does not name where it is as usual."""
PROTOCOL = flat(asdict(Protocol()), "protocol.").keys()
"""Those names of a protocol that a command line may set; the others describe it."""
NOT_SET = ("capture.name", f"capture.{CONSISTENCY_KEY}")
"""What begins like a setting and is none that decides a run."""


def common(tables: Iterable[Settings]) -> Settings:
    """What most tables that have a name say of it: told once, so that each table need only tell how it differs."""
    counts: dict[str, Counter[str]] = {}
    values: dict[str, Any] = {}
    total = 0
    for table in tables:
        total += 1
        for name, value in table.items():
            counts.setdefault(name, Counter())[repr(value)] += 1
            values.setdefault(f"{name}={value!r}", value)
    return {
        name: values[f"{name}={counted.most_common(1)[0][0]}"]
        for name, counted in counts.items()
        if 2 * counted.most_common(1)[0][1] > total
    }


class Commands:
    """Writes the command line of a run, which gives its configuration again."""

    def __init__(self, overrides: Mapping[str, Sequence[str]]) -> None:
        """``overrides``: row -> the overrides that make it; a row without any is told by its method and its prior."""
        self._overrides = overrides
        self._composed: dict[tuple[str, ...], Settings] = {}

    def of(self, run: Run, settings: Settings, given: Mapping[str, str]) -> tuple[str, str] | None:
        """What stands before and after the scene and the seed; what the row's own overrides leave different is set one by one.

        None where the configuration is unknown, or names something that this installation has not got, or a file by its content
        alone, of which ``given`` has no path.
        """
        chosen = list(self._overrides.get(run.row, ()))
        if not chosen and settings:
            chosen = [f"{kind}={settings[f'{kind}.name']}" for kind in ("method", "prior") if f"{kind}.name" in settings]
        try:
            usual = self._settings(tuple(chosen)) if settings else {}
            protocol = settings.get("protocol.name")
            if protocol != usual.get("protocol.name") and shipped(str(protocol)).name == protocol:
                chosen.append(f"protocol={protocol}")
                usual = self._settings(tuple(chosen))
        except InputError:
            return None
        if not chosen:
            return None
        mine = LEFT_OUT | settings if settings else {}
        different = {name: value for name, value in mine.items() if _settable(name) and usual.get(name) != value}
        own = []
        for name, value in different.items():
            if isinstance(value, str) and value.startswith(HASHED):
                if name not in given:
                    return None
                value = given[name]
            own.append(f"{name}={_text(value)}")
        before = " ".join(["python -m ia_bench", *map(_word, chosen)])
        return before, "".join(f" {_word(word)}" for word in (f"row={_quoted(run.row)}", *own))

    def _settings(self, overrides: tuple[str, ...]) -> Settings:
        if overrides not in self._composed:
            self._composed[overrides] = LEFT_OUT | flat(identity(compose(overrides, here=False)))
        return self._composed[overrides]


def _word(text: str) -> str:
    """A word for a shell; one with quotes in it stands in double ones where that is safe, which is easier to read and to edit."""
    return f'"{text}"' if "'" in text and not set(text) & set('"$`\\!') else shlex.quote(text)


def _settable(name: str) -> bool:
    return name in PROTOCOL or (name.startswith(SETTABLE) and name not in NOT_SET)


def _text(value: object) -> str:
    """A value as Hydra's command line has it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return _quoted(value) if isinstance(value, str) and not value.replace("_", "").isalnum() else str(value)


def _quoted(text: str) -> str:
    return text if text.replace("_", "").isalnum() else "'" + text.replace("'", "\\'") + "'"


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except InputError:
        return {}
