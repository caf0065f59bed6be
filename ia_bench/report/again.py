"""Published runs once more: a share of them is run by the command lines that their runs.csv holds, and compared score by score.

A command line names plug-ins, so that only files of people who are trusted are to be run again.
"""

from __future__ import annotations

import math
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.report.collect import HASH_DIGITS, Record, read_run
from ia_bench.runs.composition import compose
from ia_bench.runs.identity import hash_of, identity
from ia_bench.scores.metrics import MEASURED, Metric

OTHERS = 0.1
"""So many times as far as a PSNR in dB may a score of another kind be."""


@dataclass(frozen=True)
class Repeated:
    """What came of running a published ``run`` again.

    ``scores``: metric that was published -> its value then and now, NaN where it is undefined now. ``problem``: why there are none.
    ``changed``: what is another one than then, and may have left the scores alone.
    """

    run: Record
    scores: dict[Metric, tuple[float, float]]
    problem: str = ""
    changed: str = ""

    def apart(self, tolerance: float) -> list[Metric]:
        """The metrics whose values are farther apart than ``tolerance`` (dB), or OTHERS of it where they are no PSNR."""
        limits = {metric: tolerance * (1 if metric.label == "PSNR" else OTHERS) for metric in self.scores}
        return [metric for metric, (old, new) in self.scores.items() if not abs(new - old) <= limits[metric]]


def drawn(published: Sequence[Record], share: float, seed: int) -> list[Record]:
    """A share of those published runs that have not failed, at least one, in their order; the same for the same seed."""
    done = [run for run in published if "problem" not in run]
    count = min(len(done), max(1, math.ceil(round(share * len(done), 6))))  # a tenth of 30 is 3
    return [done[place] for place in sorted(np.random.default_rng(seed).choice(len(done), count, replace=False))]


def overrides_of(run: Record) -> list[str]:
    """The settings of a published run. Raises InputError where they are not recorded."""
    if not run.get("command"):
        raise InputError("its runs.csv does not hold the command line, as a report of this version does")
    if run.get("rescored_from_config_hash"):
        raise InputError(f"it was scored again, under {run.get('protocol')}, which its command line does not do")
    try:
        overrides = shlex.split(run["command"])
    except ValueError as error:
        raise InputError(f"its command cannot be read ({error})") from None
    if run.get("threads") and not any(text.startswith("threads=") for text in overrides):
        overrides.append(f"threads={run['threads']}")
    return overrides


def repeat(run: Record) -> Repeated:
    """Run a published run again, in a process of its own and a folder that goes, and compare all that was published of it."""
    try:
        overrides = overrides_of(run)
        now = hash_of(identity(compose(overrides)))[:HASH_DIGITS]
    except InputError as error:
        return Repeated(run, {}, str(error))
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "ia_bench", "run", *overrides, f"out={place}/run"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            return Repeated(run, {}, f"it fails now: {(done.stderr.strip() or 'without a word').splitlines()[-1]}")
        again = read_run(Path(place, "run"))
    if run.get("protocol", "unknown") not in ("unknown", again["protocol"]):
        return Repeated(run, {}, f"it was scored under {run['protocol']}, and is scored under {again['protocol']} now")
    known = {metric: run[metric.column] for metric in MEASURED if run.get(metric.column) is not None}
    found = {metric: again[metric.column] for metric in known}
    scores = {metric: (old, math.nan if (new := found[metric]) is None else new) for metric, old in known.items()}
    made, here = (one.get("commit") or "no checkout" for one in (run, again))
    others = f"settings, weights, scene or code ({made} then, {here} here) are others"
    changed = f"its identity is {now} now, not {run['config_hash']}: {others}"
    return Repeated(run, scores, changed="" if run["config_hash"] in (now, None) else changed)  # None: not published
