"""``ia-bench watch RUNS``: the page of a table while it is being made; nothing is run, and no run is disturbed.

It opens by a double click, tells which cells run, wait, finished and failed, and about how long the rest takes, and loads itself
again when a cell has ended. Ctrl-C ends the watch, not the runs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from ia_bench.common.arguments import Parser
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, exits, say
from ia_bench.common.paths import make_writable
from ia_bench.report.site.page import PARTS, findings_so_far, key_of, write_news, write_page
from ia_bench.runs.cells import FAILED, FINISHED, RUNNING, WAITING, Overview, look
from ia_bench.runs.table import Table, load_table, title_of

LIVE = "live"
"""The folder below a table's results that holds the page of a watch."""
LEAST_SECONDS, MOST_SECONDS = 0.2, 86_400


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = Parser(prog="ia-bench watch", description=__doc__.partition(": ")[2])
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a table's results")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help=f"folder to write the page into (default: RUNS/{LIVE})")
    parser.add_argument("--every", type=float, default=2.0, metavar="SECONDS", help="seconds between two looks (default: 2)")
    wanted = parser.parse_args(arguments)
    runs, every, out = wanted.runs, wanted.every, wanted.out or wanted.runs / LIVE
    if not LEAST_SECONDS <= every <= MOST_SECONDS:
        raise InputError(f"--every: expected {LEAST_SECONDS} to {MOST_SECONDS} seconds, found {every:g}")
    if not runs.is_dir():
        raise InputError(f"{runs}: expected a folder with runs, found none")
    overview = look(runs)
    make_writable(out, "--out")
    shown = None
    try:
        while True:
            if shown != key_of(overview):
                page = _write(overview, out, every)
                if shown is None:
                    say(f"{page} opens in a browser and follows the runs; Ctrl-C ends the watch, not the runs", sys.stdout)
                shown = key_of(overview)
                states = ", ".join(f"{len(overview.of(state))} {state}" for state in (FINISHED, RUNNING, WAITING, FAILED))
                say(f"{len(overview.cells)} cells: {states}", sys.stderr)
            write_news(out / PARTS, overview, every)
            time.sleep(every)
            overview = look(runs)
    except KeyboardInterrupt:  # SIGTERM among them
        write_news(out / PARTS, overview, every, ended=True)
        return OK


def _write(overview: Overview, out: Path, every: float) -> Path:
    table = Table()
    with suppress(InputError):  # not known here: no notes, reference and claims
        table = load_table(overview.plan.table)
    live = {"key": key_of(overview), "every": every}
    return write_page(findings_so_far(overview, table), f"Table: {title_of(overview.plan.table)}", out, live=live)
