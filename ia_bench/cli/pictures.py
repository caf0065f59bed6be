"""``python -m ia_bench.cli.pictures RUN_FOLDER --scene FOLDER --out PNG``: what a run recovered, beside the truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.exit_codes import OK, status_of
from ia_bench.common.output import say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m ia_bench.cli.pictures", allow_abbrev=False)
    parser.add_argument("run_folder", type=Path, help="folder of a finished run")
    parser.add_argument("--scene", type=Path, required=True, help="folder of its scene")
    parser.add_argument("--out", type=Path, required=True, help="PNG file to write")
    parser.add_argument("--views", type=int, default=3, help="test views, evenly chosen (default 3)")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _draw(wanted))


def _draw(wanted: argparse.Namespace) -> int:
    from ia_bench.report.pictures import write_contact_sheet  # brings in torch

    write_contact_sheet(wanted.run_folder, wanted.scene, wanted.out, views=wanted.views)
    say(str(wanted.out), sys.stdout)
    return OK


if __name__ == "__main__":
    sys.exit(main())
