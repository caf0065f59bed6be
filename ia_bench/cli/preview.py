"""``python -m ia_bench.preview RUN_FOLDER``: pictures of a run's glTF asset from a few angles, beside it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.exit_codes import OK, status_of
from ia_bench.common.output import say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m ia_bench.preview", description=__doc__, allow_abbrev=False)
    parser.add_argument("run_folder", type=Path, help="folder of a finished run (with asset.glb)")
    parser.add_argument("--views", type=int, default=4, help="angles around the object (default 4)")
    parser.add_argument("--size", type=int, default=512, help="pixels along a side (default 512)")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _render(wanted))


def _render(wanted: argparse.Namespace) -> int:
    from ia_bench.render.preview import render_preview  # brings in trimesh

    for path in render_preview(wanted.run_folder / "asset.glb", wanted.run_folder, views=wanted.views, size=wanted.size):
        say(str(path), sys.stdout)
    return OK
