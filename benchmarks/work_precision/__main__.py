"""Error against run time, in the manner of SciML's work-precision diagrams.

    python -m benchmarks.work_precision [--scene tiny|hat] [--out FOLDER]

One view with the true material and light, by every way of drawing directions, of placing points and of asking for shadows, at
rising numbers of samples: relative RMSE over seconds. Mitsuba 3 takes part where it is installed; whole fits beside it are measured
by end_to_end.py. Times are those of one thread; the first run of every case, which may compile, is discarded. A case that fails or
is not finite is a row with the reason in its last column.

FOLDER gets forward.csv, summary.json (noise floor, slopes, what was left out) and a figure.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks.work_precision.precision import write_rows
from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain
from ia_bench.common.machine import environment, settle_libraries


def main(arguments: list[str] | None = None) -> int:
    """Measure, write table and figure, print a summary. 0; 1 where a case failed; 2 for a mistake."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.work_precision", description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="hat", help="a shipped scene (default: %(default)s)")
    parser.add_argument("--threads", type=at_least(1), default=1, help="of ours and of Mitsuba (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("results/work_precision"), help="default: %(default)s")
    parser.add_argument("--quick", action="store_true", help="few samples: does everything run?")
    wanted = parser.parse_args(arguments)
    settle_libraries(wanted.threads)
    import torch

    torch.use_deterministic_algorithms(True)  # as a run has it
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    wanted.out.mkdir(parents=True, exist_ok=True)
    from benchmarks.work_precision.figures import forward_figure
    from benchmarks.work_precision.forward import measure

    try:
        rows, summary = measure(wanted.scene, threads=wanted.threads, quick=wanted.quick)
    except InputError as error:
        return complain(str(error))
    write_rows(wanted.out / "forward.csv", rows)
    with whole_file(wanted.out / "forward.png") as partial:
        forward_figure(rows, summary).savefig(partial, dpi=90)
    content = {"forward": summary, "environment": environment("cpu", wanted.threads)}
    with whole_file(wanted.out / "summary.json") as partial:
        partial.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    if "left_out" in summary:
        print(f"left out: {summary['left_out']}")
    print(f"{len(rows)} rows in {wanted.out / 'forward.csv'}")
    failures = [f"{row['case']}, {row['samples']} samples: {row['failure']}" for row in rows if row["failure"]]
    for failure in failures:
        print(f"failed: {failure}")
    return FAULT if failures else OK


if __name__ == "__main__":
    sys.exit(main())
