"""``python -m ia_bench.cli.rescore RUNS... --out FOLDER``: scores of finished runs under another protocol; nothing is fitted."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.arguments import at_least
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, INTERRUPTED, OK, complain
from ia_bench.common.machine import limit_threads
from ia_bench.common.paths import make_writable


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 1 if a run could not be scored, each of which is named."""
    parser = argparse.ArgumentParser(prog="python -m ia_bench.cli.rescore", description=__doc__, allow_abbrev=False)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUNS", help="folders that are searched for finished runs")
    parser.add_argument("--out", type=Path, required=True, help="folder of the new run folders; what is in it already is kept")
    parser.add_argument("--protocol", default="paper-v2", help="a protocol of conf/protocol (default: paper-v2)")
    parser.add_argument("--scene", type=Path, help="folder of the runs' scene, if it is not a shipped one")
    parser.add_argument("--threads", type=at_least(1), default=len(os.sched_getaffinity(0)), help="CPU threads (default: all)")
    wanted = parser.parse_args(arguments)
    try:
        limit_threads(wanted.threads)
        from ia_bench.runs.composition import compose
        from ia_bench.runs.rescore import Rescorer  # brings in the renderer

        folders = sorted({path.parent for root in wanted.runs for path in root.rglob("metrics.json")})
        if not folders:
            raise InputError(f"{', '.join(map(str, wanted.runs))}: expected a run's metrics.json below, found none")
        make_writable(wanted.out, "--out")
        protocol = compose([f"protocol={wanted.protocol}"]).protocol
        rescorer = Rescorer(protocol, wanted.out, wanted.scene)
        failed = 0
        for folder in folders:
            try:
                print(f"{folder}: {rescorer.rescore(folder)}", flush=True)
            except InputError as error:  # of this run; the others go on
                failed += 1
                complain(str(error))
    except InputError as error:
        return complain(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED
    return FAULT if failed else OK


if __name__ == "__main__":
    raise SystemExit(main())
