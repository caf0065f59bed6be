"""``ia-bench verify result.zip``: whether what is in packs gives the scores that they say; each run is scored again."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain, say, status_of
from ia_bench.common.files import user_path
from ia_bench.common.machine import limit_threads
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.runs.packs import packs_among
from ia_bench.runs.record import digest_of, json_bytes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 if every run of every pack was scored again and agrees, else 1."""
    parser = argparse.ArgumentParser(prog="ia-bench verify", description=__doc__.partition(": ")[2], allow_abbrev=False)
    parser.add_argument("packs", nargs="+", type=Path, metavar="PACKS", help="zip files, or folders with some")
    where = "folder of a scene that is not shipped; may be given several times"
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=FOLDER", help=where)
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="the result as a file, for ia-bench board")
    parser.add_argument("--threads", type=at_least(1), default=len(os.sched_getaffinity(0)), help="CPU threads (default: all)")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _verify(wanted))


def _verify(wanted: argparse.Namespace) -> int:
    limit_threads(wanted.threads)
    from ia_bench.runs.verification import OF_A_VIEW, OTHER, TOLERANCE, Verifier  # brings in the renderer

    packs = packs_among(wanted.packs)
    scenes = {}
    for text in wanted.scene:
        name, separator, folder = text.partition("=")
        if not separator:
            raise InputError(f"--scene: expected NAME=FOLDER, found {text}")
        scenes[name] = user_path("--scene", folder, folder=True)
    if wanted.out is not None:
        make_writable(wanted.out.parent, "--out")
    verifier, result = Verifier(scenes), dict[str, dict[str, str]]()
    runs, agreed = 0, True
    for path in packs:
        states = result[digest_of(path) or ""] = {}
        try:
            with Progress() as progress:
                verdicts = verifier.verify(path, progress)
        except InputError as error:  # of this pack; the others go on
            complain(str(error))
            agreed = False
            continue
        for one in verdicts:
            states[one.run.folder] = one.state
            say("; ".join([f"{path}: {one.run.row}, {one.run.scene}, seed {one.run.seed}: {one.state}", *one.says]), sys.stdout)
        runs += sum(one.state == "verified" for one in verdicts)
        agreed &= all(one.state == "verified" for one in verdicts)
    tolerated = ", ".join(f"{name} {value:g}" for name, value in {**TOLERANCE, "others": OTHER}.items())
    say(f"{runs} verified; tolerated: {tolerated}, of a single view {OF_A_VIEW:g} times as much", sys.stdout)
    if wanted.out is not None:
        with whole_file(wanted.out) as partial:
            partial.write_bytes(json_bytes(wanted.out.name, {"packs": result}))
    return OK if agreed else FAULT
