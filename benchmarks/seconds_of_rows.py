"""CPU seconds of a fit, its prior included, under several settings in turns, as ratios to the first.

    python -m benchmarks.seconds_of_rows prior=none "prior=none render.samples=64" prior=refiner "prior=refiner render.samples=64"

Each argument is the overrides of one row. All phases of a run count but scores and pictures, which are made small, and the capture.
Prints median, and least and largest in brackets, over scenes and rounds; a round has a seed of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.former_commit import shown

SMALL = ("protocol.map_points=1", "protocol.render_points=1", "protocol.samples_per_pixel=4")


def main() -> None:
    """Run the rows in turns and print a line for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", nargs="+", metavar="ROW", help="overrides of ia-bench run, with spaces between")
    parser.add_argument("--scenes", nargs="+", default=["hat"])
    parser.add_argument("--rounds", type=int, default=2)
    wanted = parser.parse_args()
    seconds: dict[str, list[float]] = {row: [] for row in wanted.rows}
    with tempfile.TemporaryDirectory() as scratch:
        for number, scene in ((number, scene) for number in range(wanted.rounds) for scene in wanted.scenes):
            for place, (row, found) in enumerate(seconds.items()):
                out = Path(scratch) / f"{scene}-{number}-{place}"
                overrides = ["threads=1", f"scene={scene}", f"seed={number}", f"out={out}", *SMALL, *row.split()]
                subprocess.run([sys.executable, "-m", "ia_bench", *overrides], check=True, stdout=subprocess.DEVNULL)
                found.append(json.loads((out / "metrics.json").read_text(encoding="utf-8"))["cpu_seconds"])
    first = next(iter(seconds.values()))
    print("| row | CPU seconds | times the first |\n| :--- | ---: | ---: |")
    for row, found in seconds.items():
        ratios = [ours / theirs for ours, theirs in zip(found, first, strict=True)]
        print(f"| {row} | {shown(found)} | {median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) |")


if __name__ == "__main__":
    main()
