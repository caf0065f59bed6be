"""``ia-bench pack RUNS --out result.zip --authors "A. Author"``: finished runs as one file that others can score again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.common.arguments import Parser
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, complain, exits, say
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import folders_with_cells
from ia_bench.runs.packs import write_pack
from ia_bench.runs.record import METRICS_FILE, RunRecord


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = Parser(prog="ia-bench pack", description=__doc__.partition(": ")[2])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUNS", help="folders of runs, or the folder of a table's results")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.zip", help="the pack to write")
    parser.add_argument("--authors", help="who brings the results, as a table shall name them")
    parser.add_argument("--url", default="", help="where a paper or the code is")
    parser.add_argument("--note", default="", help="what a reader has to know, in a sentence")
    parser.add_argument("--row", help="the runs of this row alone")
    what = (
        "zip (default); stanford-orb: pictures below the folder --out and their list beside it, for that benchmark's own evaluation"
    )
    parser.add_argument("--format", choices=("zip", "stanford-orb"), default="zip", metavar="FORMAT", help=what)
    wanted = parser.parse_args(arguments)
    folders = sorted(folder for folder in folders_with_cells(wanted.runs, complain) if (folder / METRICS_FILE).is_file())
    if wanted.row is not None:
        folders = [folder for folder in folders if RunRecord.read(folder).row == wanted.row]
    if not folders:
        of = f"row {wanted.row}" if wanted.row else "a run"
        raise InputError(f"{', '.join(map(str, wanted.runs))}: expected the {METRICS_FILE} of {of} below, found none")
    make_writable(wanted.out.parent, "--out")
    if wanted.format == "stanford-orb":
        from ia_bench.runs.submissions import write_submission  # brings in the renderer

        with Progress() as progress:
            say(f"{write_submission(folders, wanted.out, begin=progress.task)} is for scripts/test.py of Stanford-ORB", sys.stdout)
        return OK
    if wanted.out.suffix != ".zip":
        raise InputError(f"--out: expected a name that ends with .zip, found {wanted.out}")
    if wanted.authors is None:
        raise InputError('--authors: expected who brings the results, as --authors "A. Author", found none')
    manifest = write_pack(folders, wanted.out, authors=wanted.authors, url=wanted.url, note=wanted.note)
    failed = sum(RunRecord.read(folder).status == "failed" for folder in folders)
    what = f"{len(manifest.runs)} runs" if len(manifest.runs) > 1 else "1 run"
    said = f", {failed} of which failed" if failed else ""
    say(f"{wanted.out}: {what}{said}, {wanted.out.stat().st_size / 1e6:.1f} MB; ia-bench verify {wanted.out} checks it", sys.stdout)
    return OK
