"""``ia-bench rescore RUNS... --out FOLDER``: scores of finished runs under another protocol; nothing is fitted."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.arguments import Parser, at_least
from ia_bench.common.errors import Fault, InputError
from ia_bench.common.exit_codes import FAULT, OK, complain, exits, say
from ia_bench.common.machine import cores, settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import folders_with_cells
from ia_bench.runs.record import METRICS_FILE
from ia_bench.scores.protocol import Protocol


@exits(resumes=True)
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 1 if a run could not be scored, each of which is named."""
    parser = Parser(prog="ia-bench rescore", description=__doc__.partition(": ")[2])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUNS", help="folders that are searched for finished runs")
    parser.add_argument("--out", type=Path, required=True, help="folder of the new run folders; what is in it already is kept")
    parser.add_argument("--protocol", default=Protocol.name, help="a protocol of conf/protocol (default: %(default)s)")
    parser.add_argument("--scene", type=Path, help="folder of the runs' scene, if it is no longer where they found it")
    parser.add_argument("--threads", type=at_least(1), default=cores(), help="CPU threads (default: all)")
    wanted = parser.parse_args(arguments)
    settle_libraries(wanted.threads)
    from ia_bench.runs.composition import compose
    from ia_bench.runs.recovered import Rescorer  # brings in the renderer

    found = sorted(folder for folder in folders_with_cells(wanted.runs, complain) if (folder / METRICS_FILE).is_file())
    folders = [folder for folder in found if wanted.out.resolve() not in folder.resolve().parents] or found  # not its own again
    if not folders:
        raise InputError(f"{', '.join(map(str, wanted.runs))}: expected a run's {METRICS_FILE} below, found none")
    make_writable(wanted.out, "--out")
    protocol, rescorer = compose([f"protocol={wanted.protocol}"]).protocol, Rescorer()
    failed = 0
    for folder in folders:
        try:
            with Progress() as progress:
                place = rescorer.rescore(folder, protocol, wanted.out, wanted.scene, progress)
            say(f"{folder}: {place}", sys.stdout)
        except (InputError, Fault) as error:  # of this run; the others go on
            failed += 1
            complain(str(error))
    return FAULT if failed else OK
