"""Whether the runs of a pack score what they say they do: their hashes are checked, and what they recovered is scored again.

It shows that the files give the scores. How the files came about, how long that took and the curve on the way remain declared.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from ia_bench.common.errors import Fault, InputError, raised
from ia_bench.common.progress import Progress
from ia_bench.common.settings import flat
from ia_bench.runs.identity import hash_of, protocol_hash
from ia_bench.runs.packs import PackedRun, check_reader, problems, unpack
from ia_bench.runs.record import METRICS_FILE, RunRecord
from ia_bench.runs.recovered import Recovered, Rescorer

TOLERANCE = {"psnr": 0.02, "ssim": 5e-4, "lpips": 5e-4, "mse": 1e-4}
"""How far a score may be from what is found again, by the name of its metric; OTHER of it where the name is another."""
OTHER = 1e-3
OF_A_VIEW = 5.0
"""So many times as far may a single view be: its noise does not average out."""
MOST = 3
"""So many scores that differ are told, the farthest first."""
WEIGHTS = "lpips.weights"  # where the file lies that LPIPS was read from: its content is in the identity
State = Literal["verified", "differs", "not scored again"]


@dataclass(frozen=True)
class CheckedRun:
    """What was found of one run of a pack.

    Attributes:
        folder: Where in the pack it lies.
        name: Its row, scene and seed, or its folder where its record cannot be read.
        state: "differs" where a hash or a score is another one; "not scored again" where that cannot be done here.
        says: Why, a sentence each; nothing of a verified run.
    """

    folder: str
    name: str
    state: State
    says: tuple[str, ...]


def verify(path: Path, scenes: Mapping[str, Path], rescorer: Rescorer, progress: Progress) -> list[CheckedRun]:
    """A verdict on every run of the pack ``path``, scene by scene. Raises InputError for what is no pack, or a damaged one.

    ``scenes``: name of a scene -> its folder here, for those that are not shipped.
    """
    with tempfile.TemporaryDirectory() as place:
        runs = sorted(unpack(path, Path(place)).runs, key=lambda run: run.folder)
        return [_checked(run, Path(place), scenes, rescorer, progress) for run in runs]


def _checked(run: PackedRun, place: Path, scenes: Mapping[str, Path], rescorer: Rescorer, progress: Progress) -> CheckedRun:
    said, name = problems(run, place), run.folder
    state: State = "not scored again"
    try:
        record = RunRecord.read(place / run.folder)
        name = f"{record.row}, {record.scene}, seed {record.seed}"
        if record.status != "ok":
            raise InputError("the run failed")
        progress.note(f"{name}: scoring again")
        check_reader(place / run.folder)
        recovered = Recovered(place / run.folder)
        said += _inconsistent(recovered)
        config = recovered.config
        found = rescorer.score(recovered, config.protocol, scenes.get(config.scene.name), progress.task).as_dict()
        apart, state = differences(asdict(record), found), "verified"
    except Exception as error:  # what is read of a pack is somebody else's
        told = str(error) if isinstance(error, InputError | Fault) else raised(error)
        apart = () if said else (told.replace(f"{place}/", ""),)
    return CheckedRun(run.folder, name, "differs" if said or (apart and state == "verified") else state, (*said, *apart))


def differences(told: Mapping[str, Any], found: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for each of the MOST scores that are farther apart than TOLERANCE, the farthest first, and how many more are.

    ``told`` and ``found`` hold the groups of numbers of :class:`~ia_bench.scores.evaluate.Scores`.
    """
    apart: list[tuple[float, str]] = []
    for group in ("metrics", "variants", "per_image", "geometry"):
        mine, theirs = (dict(_numbers(flat(one.get(group, {})))) for one in (told, found))
        for key, before in mine.items():  # what a record of a former version lacks is no claim
            after = theirs.get(key)
            name = key.partition("[")[0].rpartition(".")[2]
            tolerance = TOLERANCE.get(name, OTHER) * (OF_A_VIEW if "[" in key else 1)
            far = 0.0 if before is after else math.inf
            if before is not None and after is not None:
                far = abs(before - after)
            if far > tolerance:
                by = f", {far:.4g} apart where {tolerance:g} is tolerated" if math.isfinite(far) else ""
                said = ("no number" if value is None else f"{value:.6g}" for value in (before, after))
                apart.append((far / tolerance, f"{group}.{key}: the record says {next(said)}, scored again it is {next(said)}{by}"))
    apart.sort(reverse=True)
    more = len(apart) - MOST
    return (*(text for _, text in apart[:MOST]), *([f"and {more} more scores that differ"] if more > 0 else []))


def _numbers(values: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Every number by its dotted name, with its place in brackets where it is one of several; texts are none."""
    for name, value in values.items():
        for place, one in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if one is None or isinstance(one, int | float):
                yield name if place is None else f"{name}[{place}]", one


def _inconsistent(run: Recovered) -> list[str]:
    """What of a record and its configuration contradict each other."""
    identity, record = run.setup.identity, run.record
    hashes = {"config_hash": hash_of(identity)}
    with suppress(KeyError, TypeError):  # of a configuration without: its hash is none of these
        hashes["protocol_hash"] = protocol_hash(identity)
    wrong = [name for name, hash_ in hashes.items() if getattr(record, name) != hash_]
    said = [f"{METRICS_FILE}: {name} is not that of the configuration" for name in wrong]
    for name, told_of, is_of in (("scene", record.scene, run.config.scene.name), ("seed", record.seed, run.config.seed)):
        if told_of != is_of:
            said.append(f"{METRICS_FILE}: {name} is {told_of}, and {is_of} in the configuration")
    told, found = map(flat, (record.protocol_description, run.config.protocol.describe()))
    if told | {WEIGHTS: None} != found | {WEIGHTS: None}:
        said.append(f"{METRICS_FILE}: protocol_description is not what this version computes for {record.protocol}")
    return said
