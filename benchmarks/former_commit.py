"""Error against run time of whole fits: this code beside a former commit.

    python -m benchmarks.former_commit COMMIT [--scene hat] [--rounds 5] [--out results/former] [OVERRIDE...]

Every fit is a run of its own, `ia-bench run prior=none threads=1` with the OVERRIDEs, in a process whose clock is the CPU
time of its one thread; the sides take turns, round after round, with the seed of the round. Of each it prints when a level of the
aligned albedo and of relighting was first measured (least, median and largest over the rounds) and how many times sooner this
code had it; the figure has the curves of all rounds.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median, median_low

from benchmarks.work_precision.precision import first_time
from ia_bench.report.curves import save
from ia_bench.runs.config import SceneConfig, resolve_scene_folder

METRICS = {"aligned_albedo_psnr": "aligned albedo, dB", "relighting_psnr": "relighting, dB"}
NOW = "this code"
RUN = """
import sys, time
time.perf_counter = time.process_time
from ia_bench.cli.run import main
sys.exit(main(sys.argv[1:]))
"""
Curve = list[dict[str, str]]


def curve_of(code: Path, out: Path, overrides: Sequence[str]) -> Curve:
    """The rows of curve.csv of one run by the package in the folder ``code``, seconds in CPU time."""
    environment = {**os.environ, "PYTHONPATH": f"{code}{os.pathsep}{code / 'baselines'}", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", RUN, "threads=1", f"out={out}", *overrides]
    subprocess.run(command, cwd=code, env=environment, check=True, stdout=subprocess.DEVNULL)
    with (out / "curve.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def times_to(curves: Sequence[Curve], metric: str, level: float) -> list[float]:
    """Seconds to the level in each round; infinite where it was never measured."""
    found = []
    for rows in curves:
        seconds, values = ([float(row[key]) for row in rows] for key in ("seconds", metric))
        reached = first_time(seconds, values, level)
        found.append(math.inf if reached is None else reached)
    return found


def table(curves: dict[str, list[Curve]], metric: str) -> list[str]:
    """Lines of Markdown: a row for each whole decibel that this code reaches in most rounds, without the first above its least."""
    lines = [f"| {METRICS[metric]} | " + " | ".join(f"{side}, s" for side in curves) + " | times sooner |"]
    lines.append("| ---: |" + " ---: |" * (len(curves) + 1))
    values = [[float(row[metric]) for row in rows] for rows in curves[NOW]]
    for level in range(math.ceil(min(min(v) for v in values)) + 1, math.floor(median_low(max(v) for v in values)) + 1):
        times = {side: times_to(rounds, metric, level) for side, rounds in curves.items()}
        ours = median(times[NOW])
        ratios = [f"{median(t) / ours:.1f}" if median(t) < math.inf else "never" for side, t in times.items() if side != NOW]
        cells = [shown(seconds) for seconds in times.values()]
        lines.append(f"| {level} | " + " | ".join(cells) + f" | {' / '.join(ratios)} |")
    return lines


def shown(seconds: Sequence[float]) -> str:
    """Median, and least and largest in brackets."""
    low, middle, high = ("never" if s == math.inf else f"{s:.1f}" for s in (min(seconds), median(seconds), max(seconds)))
    return middle if low == high else f"{middle} ({low} to {high})"


def draw(curves: dict[str, list[Curve]], scene: str, path: Path) -> None:
    """One panel a metric, one thin line a round."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    for panel, (metric, label) in zip(figure.subplots(1, len(METRICS)), METRICS.items(), strict=True):
        for index, (side, rounds) in enumerate(curves.items()):
            for number, rows in enumerate(rounds):
                seconds, values = ([float(row[key]) for row in rows] for key in ("seconds", metric))
                panel.plot(seconds, values, marker=".", linewidth=1, color=f"C{index}", label=None if number else side)
        panel.set(xscale="log", xlabel="CPU seconds of the fit, one thread", ylabel=label)
        panel.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False)
    figure.suptitle(f"{scene}, no prior: error against run time")
    save(figure, path)


def main() -> None:
    """Run the sides in turns, print the tables, write curves and figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("commit", help="to compare this code with")
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="of ia-bench run, for all sides")
    parser.add_argument("--scene", default="hat")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("results/former"))
    wanted = parser.parse_intermixed_args()
    here = Path(__file__).resolve().parents[1]
    wanted.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        former = Path(scratch) / "former"
        subprocess.run(["git", "-C", here, "worktree", "add", "--quiet", "--detach", former, wanted.commit], check=True)
        try:
            sides = {NOW: here, wanted.commit: former}
            curves: dict[str, list[Curve]] = {side: [] for side in sides}
            for number in range(wanted.rounds):
                for index, (side, code) in enumerate(sides.items()):
                    scene = f"scene.path={resolve_scene_folder(SceneConfig(wanted.scene))}"
                    overrides = ["prior=none", scene, f"seed={number}", *wanted.overrides]
                    curves[side].append(curve_of(code, Path(scratch) / f"{index}-{number}", overrides))
        finally:
            subprocess.run(["git", "-C", here, "worktree", "remove", "--force", former], check=True)
    for metric in METRICS:
        print("\n".join([*table(curves, metric), ""]))
    with (wanted.out / "curves.csv").open("w", encoding="utf-8", newline="") as file:
        rows = [{"side": s, "seed": n, **row} for s, rounds in curves.items() for n, rows in enumerate(rounds) for row in rows]
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    draw(curves, wanted.scene, wanted.out / "error_against_time")


if __name__ == "__main__":
    main()
