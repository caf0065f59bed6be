"""Where a number comes from: the command that made its run, its configuration, files, machine and commit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.settings import flat
from ia_bench.report.collect import HASH_DIGITS, setup_of
from ia_bench.runs.record import RunRecord

DIGITS = 12  # of a file's checksum
MACHINE = ("cpu", "cores", "threads", "device", "system", "python", "commit")
OF_A_RUN = ("seed", "scene.", "out", "row")  # begin settings that every run tells by itself


def evidence_of(run: Mapping[str, Any]) -> dict[str, Any]:
    """What a run's folder says of how its numbers came about; nothing of a run that only a runs.csv knows.

    ``settings``: its configuration, flat; ``command``: its command line; ``environment``: machine, versions and commit, flat;
    ``files``: name -> the first digits of the SHA-256 of what the run wrote; ``renderer``: who drew the pictures that were scored.
    """
    setup = setup_of(run["folder"])
    if setup is None:
        return {}
    try:
        record = RunRecord.read(run["folder"])
    except (InputError, FileNotFoundError):
        return {}
    if record.row != run["row"] and record.config_hash[:HASH_DIGITS] != run["config_hash"]:
        return {}  # the folder is that of a report, not of this run
    environment = record.environment
    machine = {key: environment[key] for key in MACHINE if environment.get(key) is not None}
    packages = environment.get("packages")
    versions = flat(packages, "packages.") if isinstance(packages, dict) else {}
    return {
        "settings": {name: value for name, value in flat(setup.config).items() if not name.startswith(OF_A_RUN)},
        "command": setup.command,
        "environment": machine | versions,
        "files": {name: digest[:DIGITS] for name, digest in record.files.items()},
        "renderer": record.renderer,
    }
