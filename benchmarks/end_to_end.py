"""Time to a given error of the albedo: our fit beside a plain loop of Mitsuba 3 and Adam, on the same scene.

    python benchmarks/end_to_end.py [--scene hat] [--prior oracle|none] [--out FOLDER]

Both get the true albedo of the training views as their prior's sample (or, with ``--prior none``, nothing), start from the
same material, use the same sizes, losses of image and albedo, learning rates and 32 samples a pixel; see
ia_bench/checks/mitsuba_fit.py for what the plain loop lacks. A fit's error depends on how many steps its learning rates have
to fall, so each is run with several numbers of steps, and the *best* time to reach a level counts, for either side. Errors
are scored off the clock at doubling steps by the same scorer; the clock is the CPU time of one thread, without the first
steps, which compile.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import torch
from stage import run_as_a_run

from benchmarks.work_precision.precision import first_time, without_compilation
from benchmarks.work_precision.problem import make_problem
from ia_bench.common.machine import environment
from ia_bench.common.paths import scenes_folder
from ia_bench.methods.asking.sampling import PriorSampler
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import Prior
from ia_bench.priors.none import NoPrior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.readers.native import NativeReader
from ia_bench.render.reconstruction import Reconstruction
from ia_bench.scores.scorer import Scorer
from ia_bench_baselines.mitsuba_adam.fit import MitsubaFit

METRICS = ("aligned_albedo_psnr", "view_synthesis_psnr", "relighting_psnr", "roughness_mse")
FIRST_SCORE = 25


class Clock:
    """A curve of errors over CPU seconds that do not count the scoring."""

    def __init__(self, scorer: Scorer) -> None:
        self.rows: list[dict[str, float]] = []
        self._scorer, self._off, self._started = scorer, 0.0, time.process_time()

    def score(self, step: int, found: Reconstruction) -> None:
        """Add a row."""
        now = time.process_time()
        values = self._scorer.quick(found)
        self.rows.append({"step": step, "seconds": now - self._started - self._off, **{m: values[m] for m in METRICS}})
        self._off += time.process_time() - now

    def finished(self) -> list[dict[str, float]]:
        """The rows, with the compiler's time taken out."""
        steps, seconds = ([row[key] for row in self.rows] for key in ("step", "seconds"))
        for row, value in zip(self.rows, without_compilation(steps, seconds), strict=True):
            row["seconds"] = value
        return self.rows


def our_fit(problem: Problem, scorer: Scorer, steps: int) -> list[dict[str, float]]:
    """The curve of our two-stage trainer over ``steps``, two thirds of them in stage 1 as by default."""
    torch.compiler.reset()  # the compiler keeps few versions of a function
    first = round(steps * 2 / 3)
    clock = Clock(scorer)
    monitor = Monitor.silent(note=print, score=lambda _, step, __, found: clock.score(step, found))
    settings = FitSettings(stage1_steps=first, stage2_steps=steps - first, guided=False)
    clock.score(steps, TwoStage(settings).fit(problem, seed=0, monitor=monitor).reconstruction)
    return clock.finished()


def mitsuba_fit(problem: Problem, scorer: Scorer, steps: int, threads: int) -> list[dict[str, float]]:
    """The curve of the plain loop over ``steps``."""
    clock, prior = Clock(scorer), problem.prior
    albedo = None
    if "albedo" in prior.info.provides:
        albedo = list(PriorSampler(problem, prior, 0, print).draw(None).values["albedo"].numpy())
    fit = MitsubaFit(problem, FitSettings(), steps, albedo=albedo, threads=threads)
    while fit.step < steps:
        fit.advance()
        ratio = fit.step / FIRST_SCORE
        if fit.step == steps or (ratio >= 1 and math.log2(ratio).is_integer()):
            clock.score(fit.step, fit.snapshot())
    return clock.finished()


def levels_of(curves: list[list[dict[str, float]]]) -> list[float]:
    """Whole decibels from the worst of the first scores to the best of all."""
    values = [[row["aligned_albedo_psnr"] for row in rows] for rows in curves]
    low, high = min(v[0] for v in values), max(max(v) for v in values)
    return [float(level) for level in range(math.ceil(low), math.floor(high) + 1)]


def best_time(curves: dict[int, list[dict[str, float]]], level: float) -> tuple[float, int] | None:
    """The least seconds to ``level`` dB of aligned albedo over all numbers of steps, and that number; None if never."""
    times = []
    for steps, rows in curves.items():
        time_to = first_time([row["seconds"] for row in rows], [row["aligned_albedo_psnr"] for row in rows], level)
        if time_to is not None:
            times.append((time_to, steps))
    return min(times) if times else None


def main() -> None:
    """Fit, print times to each level, and write the curves."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="hat", help="a shipped scene")
    parser.add_argument("--prior", choices=("oracle", "none"), default="oracle")
    parser.add_argument("--steps", type=int, nargs="+", default=[100, 300, 600], help="lengths of our fits")
    parser.add_argument("--mitsuba-steps", type=int, nargs="+", default=[100, 300, 600, 1200], help="and of Mitsuba's")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for end_to_end_<prior>.json")
    arguments = parser.parse_args()
    run_as_a_run(arguments.threads)
    prior: Prior = OraclePrior(components=["albedo"]) if arguments.prior == "oracle" else NoPrior()
    scene = NativeReader(scenes_folder() / arguments.scene).read(truth=True)
    problem, scorer = make_problem(scene, prior, shading="compiled")
    curves = {
        "ours": {steps: our_fit(problem, scorer, steps) for steps in arguments.steps},
        "Mitsuba 3": {
            steps: mitsuba_fit(problem, scorer, steps, arguments.threads) for steps in arguments.mitsuba_steps
        },
    }
    print(f"| {arguments.scene}, prior {arguments.prior}: steps | CPU s | " + " | ".join(METRICS) + " |")
    print("| :--- | ---: |" + " ---: |" * len(METRICS))
    for name, fits in curves.items():
        for steps, rows in fits.items():
            last = rows[-1]
            print(f"| {name}, {steps} | {last['seconds']:.1f} | " + " | ".join(f"{last[m]:.4g}" for m in METRICS) + " |")
    print("\n| aligned albedo, dB | ours, s (steps) | Mitsuba 3 + Adam, s (steps) | times sooner |")
    print("| ---: | ---: | ---: | ---: |")
    everything = [rows for fits in curves.values() for rows in fits.values()]
    for level in levels_of(everything):
        times = {name: best_time(fits, level) for name, fits in curves.items()}
        cells = ["never" if t is None else f"{t[0]:.1f} ({t[1]})" for t in times.values()]
        ours, other = times["ours"], times["Mitsuba 3"]
        longest = max(rows[-1]["seconds"] for rows in curves["Mitsuba 3"].values())
        ratio = "-" if ours is None else f"{other[0] / ours[0]:.1f}" if other else f"> {longest / ours[0]:.1f}"
        print(f"| {level:.0f} | {cells[0]} | {cells[1]} | {ratio} |")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        content = {"curves": curves, "environment": environment("cpu", arguments.threads), **vars(arguments)}
        content["out"] = None
        (arguments.out / f"end_to_end_{arguments.prior}.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
