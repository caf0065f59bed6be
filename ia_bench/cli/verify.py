"""``ia-bench verify``: whether published numbers come out again: packs are scored again, cells of a runs.csv are run again."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from pathlib import Path

from ia_bench.common.arguments import Parser, at_least, number_of
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError, printable
from ia_bench.common.exit_codes import FAULT, OK, complain, exits, say
from ia_bench.common.files import user_path
from ia_bench.common.machine import cores, settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.runs.packs import packs_among
from ia_bench.runs.record import digest_of, json_bytes

TABLE = "runs.csv"


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 if every run was scored or run again and agrees, else 1."""
    parser = Parser(prog="ia-bench verify", description=__doc__.partition(": ")[2])
    what = "zip files of ia-bench pack, runs.csv files of reports, or folders with some of either"
    parser.add_argument("published", nargs="+", type=Path, metavar="PUBLISHED", help=what)
    where = "folder of a scene that is not shipped; may be given several times"
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=FOLDER", help=where)
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="the result as a file, for ia-bench board")
    parser.add_argument("--threads", type=at_least(1), default=cores(), help="CPU threads (default: all)")
    cells = parser.add_argument_group("of a runs.csv, whose cells are run again with the threads that they were published with")
    share = number_of("a number above 0 and up to 1", lambda part: 0 < part <= 1)
    cells.add_argument("--share", type=share, default=0.1, help="of its cells, drawn by chance (default: a tenth)")
    cells.add_argument("--seed", type=at_least(0), default=0, help="which ones (default: 0)")
    decibels, about = number_of("0 or more", lambda dB: dB >= 0), "in dB; a tenth of it in other scores (default: 0.001)"
    cells.add_argument("--tolerance", type=decibels, default=1e-3, help=about)
    wanted = parser.parse_args(arguments)
    tables = [table for path in wanted.published for table in ([path] if path.suffix == ".csv" else sorted(path.rglob(TABLE)))]
    packs = list[Path]()
    for path in wanted.published:
        if path.suffix != ".csv":
            with suppress(InputError) if path.is_dir() and any(path.rglob(TABLE)) else nullcontext():  # that may be all there is
                packs += packs_among([path])
    if tables and (wanted.out is not None or wanted.scene):
        raise InputError("--out and --scene: expected packs, found tables: their cells are run as their runs.csv says")
    states = [_repeat(wanted, tables)] if tables else []
    states += [_score_again(wanted, packs)] if packs else []
    return max(states)


def _repeat(wanted: argparse.Namespace, tables: Sequence[Path]) -> int:
    from ia_bench.report.again import drawn, repeat  # brings in Hydra, and what a run is made of
    from ia_bench.report.collect import name_of, read_published

    published = [run for path in tables for run in read_published(path)]
    chosen = drawn(published, wanted.share, wanted.seed)
    if not chosen:
        say(f"{', '.join(map(str, tables))}: expected a run that has not failed, found {len(published)} that have", sys.stderr)
        return FAULT  # packs beside them may be checked all the same
    say(
        f"{len(published)} published cells, of which {len(chosen)} are run again (--share {wanted.share:g} --seed {wanted.seed})",
        sys.stdout,
    )
    counts = Counter[str]()
    for run in chosen:
        found = repeat(run)
        apart = found.apart(wanted.tolerance)
        state = "not run again" if found.problem else "differs" if apart else "agrees"
        counts[state] += 1
        why = found.problem or found.changed
        say(f"{run['folder']}: {name_of(run)}: {state}{why and f': {why}'}", sys.stdout)
        for metric, (old, new) in found.scores.items():
            mark = "  <-" if metric in apart else ""
            say(f"  {metric.key:<24}{old:>12.6f}{new:>12.6f}{new - old:>+12.6f}{mark}", sys.stdout)
    say(f"{', '.join(f'{count} {state}' for state, count in counts.items())}; tolerance {wanted.tolerance:g} dB", sys.stdout)
    return OK if set(counts) == {"agrees"} else FAULT


def _score_again(wanted: argparse.Namespace, packs: Sequence[Path]) -> int:
    settle_libraries(wanted.threads)
    from ia_bench.runs.recovered import Rescorer  # brings in the renderer
    from ia_bench.runs.verification import OF_A_VIEW, OTHER, TOLERANCE, verify

    scenes = {}
    for text in wanted.scene:
        name, separator, folder = text.partition("=")
        if not separator:
            raise InputError(f"--scene: expected NAME=FOLDER, found {text}")
        scenes[name] = user_path("--scene", folder, folder=True)
    if wanted.out is not None:
        make_writable(wanted.out.parent, "--out")
    rescorer, result = Rescorer(), dict[str, dict[str, str]]()
    runs, agreed = 0, True
    for path in dict.fromkeys(packs):
        states, digest = dict[str, str](), digest_of(path)
        if digest is not None:  # of a file that can be read at all
            result[digest] = states
        try:
            with Progress() as progress:
                verdicts = verify(path, scenes, rescorer, progress)
        except InputError as error:  # of this pack; the others go on
            complain(str(error))
            agreed = False
            continue
        for one in verdicts:
            states[one.folder] = one.state
            say(printable("; ".join([f"{path}: {one.name}: {one.state}", *one.says])), sys.stdout)
        runs += sum(one.state == "verified" for one in verdicts)
        agreed &= all(one.state == "verified" for one in verdicts)
    tolerated = ", ".join(f"{name} {value:g}" for name, value in {**TOLERANCE, "others": OTHER}.items())
    say(f"{runs} verified; tolerated: {tolerated}, of a single view {OF_A_VIEW:g} times as much", sys.stdout)
    if wanted.out is not None:
        with whole_file(wanted.out) as partial:
            partial.write_bytes(json_bytes(wanted.out.name, {"packs": result}))
    return OK if agreed else FAULT
