"""Error against run time, in the manner of SciML's work-precision diagrams.

    python -m benchmarks.work_precision [--scene tiny|hat] [--only forward|inverse] [--out FOLDER]

*Forward*: one view with the true material and light, by every way of drawing directions, of placing points and of asking
for shadows, at rising numbers of samples: relative RMSE over seconds. *Inverse*: whole fits of the scene ``tiny`` at several
samples a pixel, pixels a step and numbers of steps: PSNR over seconds. Mitsuba 3 takes part in both where it is installed.
Times are those of one thread; the first run of every case, which may compile, is discarded. A case that fails or is not
finite is a row with the reason in its last column.

FOLDER gets forward.csv, inverse.csv, summary.json (noise floor, slopes, what was left out) and a figure of each part.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.work_precision.precision import write_rows
from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain
from ia_bench.common.machine import environment, settle_libraries

PARTS = ("forward", "inverse")


def main(arguments: list[str] | None = None) -> int:
    """Measure, write tables and figures, print a summary. 0; 1 where a case failed; 2 for a mistake."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.work_precision", description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="hat", help="shipped scene of the forward part (default: %(default)s)")
    parser.add_argument("--only", choices=PARTS, help="one part alone")
    parser.add_argument("--threads", type=at_least(1), default=1, help="of ours and of Mitsuba (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("results/work_precision"), help="default: %(default)s")
    parser.add_argument("--quick", action="store_true", help="few samples and steps: does everything run?")
    wanted = parser.parse_args(arguments)
    settle_libraries(wanted.threads)
    import torch

    torch.use_deterministic_algorithms(True)  # as a run has it
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    wanted.out.mkdir(parents=True, exist_ok=True)
    parts = PARTS if wanted.only is None else (wanted.only,)
    try:
        failures = [failure for part in parts for failure in _measure_part(part, wanted)]
    except InputError as error:
        return complain(str(error))
    for failure in failures:
        print(f"failed: {failure}")
    return FAULT if failures else OK


def _measure_part(part: str, wanted: argparse.Namespace) -> list[str]:
    """Measure one part, write its files, and return its failures, a line each."""
    from benchmarks.work_precision import figures

    rows: list[dict[str, Any]]
    if part == "forward":
        from benchmarks.work_precision import forward

        rows, summary = forward.measure(wanted.scene, threads=wanted.threads, quick=wanted.quick)
        figure = figures.forward_figure(rows, summary)
    else:
        from benchmarks.work_precision import inverse

        rows, summary = inverse.measure(threads=wanted.threads, quick=wanted.quick)
        figure = figures.inverse_figure(rows)
    write_rows(wanted.out / f"{part}.csv", rows)
    with whole_file(wanted.out / f"{part}.png") as partial:
        figure.savefig(partial, dpi=90)
    path = wanted.out / "summary.json"
    content = json.loads(path.read_text()) if path.is_file() else {}
    content |= {part: summary, "environment": environment("cpu", wanted.threads)}
    with whole_file(path) as partial:
        partial.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    if "left_out" in summary:
        print(f"left out: {summary['left_out']}")
    print(f"{part}: {len(rows)} rows in {wanted.out / part}.csv")
    return [f"{part}, {row['case']}, {row['samples']} samples: {row['failure']}" for row in rows if row["failure"]]


if __name__ == "__main__":
    sys.exit(main())
