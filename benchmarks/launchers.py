"""What a launcher costs per cell: tables of cells whose run does nothing, one cell at a time.

    python -m benchmarks.launchers [--cells 5] [--launchers local submitit_local ray]

A table of one cell takes start + cell, one of CELLS takes start + CELLS x cell; both are printed, in seconds of CPU time of all
processes, which other programs disturb less, and by the wall clock. A cell is a new process that imports the program and torch,
composes its configuration, locks its folder and writes results as `tests/cli/fake_run` has them.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from ia_bench.cli.table import parse
from ia_bench.common.arguments import at_least
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import make_cells
from ia_bench.runs.launchers import LAUNCHERS
from ia_bench.runs.schedule import run_cells
from ia_bench.runs.table import Row, Table

ROOT = Path(__file__).resolve().parents[1]
SPENT = Path("cpu")
RAN = [name for name in LAUNCHERS if name != "submitit_slurm"]


def main() -> None:
    """Time two tables with each launcher and print a table of Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=at_least(2), default=5)
    parser.add_argument("--launchers", nargs="+", choices=RAN, default=RAN)
    wanted = parser.parse_args()
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT / "tests" / "cli" / "fake_run"), str(ROOT)])
    print("| launcher | start, CPU (s) | a cell, CPU (s) | start, wall (s) | a cell, wall (s) |")
    print("| :--- | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        os.environ |= {"FAKE_LOG": str(Path(folder, "log")), "FAKE_CPU": str(SPENT.absolute())}
        for name in wanted.launchers:
            one, many = seconds(name, 1), seconds(name, wanted.cells)
            cells = [(b - a) / (wanted.cells - 1) for a, b in zip(one, many, strict=True)]
            shown = [f"{part:.1f}" for a, cell in zip(one, cells, strict=True) for part in (a - cell, cell)]
            print(" | ".join([f"| `{name}`", *shown]), "|", flush=True)


def seconds(launcher: str, count: int) -> tuple[float, float]:
    """CPU and wall-clock seconds of a table of ``count`` cells that nobody has run."""
    request = parse([f"launcher={launcher}", "device=cpu"])
    results = Path(f"{launcher}-{count}")
    table = Table(scenes=["tiny"], seeds=list(range(count)), rows=[Row("nothing", ["prior=none"])])
    cells = make_cells(table, request, 1, results)
    SPENT.unlink(missing_ok=True)
    before = clocks()
    with Progress() as progress:
        assert run_cells(cells, request.launcher, 1, results / "logs", progress) == 0
    after = clocks()
    workers = sum(map(float, SPENT.read_text().split())) if launcher == "ray" else 0.0  # whose workers are no children of ours
    return after[0] - before[0] + workers, after[1] - before[1]


def clocks() -> tuple[float, float]:
    """CPU time of this process and of all that it started and that have ended, and the wall clock."""
    return sum(os.times()[:4]), time.monotonic()


if __name__ == "__main__":
    main()
