"""``python -m ia_bench.cli.comparison --scene FOLDER --out PNG [NAME=]RUN_FOLDER...``: runs beside each other and the truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, complain, status_of
from ia_bench.common.output import say
from ia_bench.runs.folder import folders_among


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m ia_bench.cli.comparison", allow_abbrev=False)
    parser.add_argument("runs", nargs="+", help="[NAME=]RUN_FOLDER; without a name the folder's")
    parser.add_argument("--scene", type=Path, required=True, help="folder of their scene")
    parser.add_argument("--out", type=Path, required=True, help="PNG file to write")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _draw(wanted))


def _draw(wanted: argparse.Namespace) -> int:
    from ia_bench.report.comparison import write_comparison  # brings in torch

    given = [text.split("=", 1) if "=" in text else [Path(text).name, text] for text in wanted.runs]
    unnamed = [Path(text) for text in wanted.runs if "=" not in text]
    passed_over = {str(path) for path in unnamed} - {str(path) for path in folders_among(unnamed, complain)}
    pairs = [(name, place) for name, place in given if place not in passed_over]
    names = [name for name, _ in pairs]
    if len(set(names)) < len(names):
        raise InputError(f"expected different names of the runs, found {', '.join(names)}; write NAME=RUN_FOLDER")
    write_comparison({name: Path(folder) for name, folder in pairs}, wanted.scene, wanted.out)
    say(str(wanted.out), sys.stdout)
    return OK


if __name__ == "__main__":
    sys.exit(main())
