"""Time to a given error of the albedo: our fit beside a plain loop of Mitsuba 3 and Adam, on the same scene.

    python benchmarks/end_to_end.py [--scene hat] [--prior oracle|none] [--out FOLDER]

Both get the true albedo of the training views as their prior's sample (or, with ``--prior none``, nothing), start from the
same material, use the same sizes, losses of image and albedo, learning rates, 32 samples a pixel, direct light and lobes that
are added; the card of the baseline ``mitsuba_adam`` says what the plain loop lacks. A fit's error depends on how many steps its
learning rates have to fall, so each is run with several numbers of steps, and the *best* time to reach a level counts, for
either side. Errors are scored off the clock at doubling steps by the same scorer, each fit's pictures drawn by its own renderer;
the clock is the CPU time of one thread, without the first steps, which compile.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

from benchmarks.stage import run_as_a_run
from benchmarks.work_precision.precision import first_time, without_compilation
from ia_bench.common.machine import environment
from ia_bench.methods.contract import Method, Monitor, NoCoupling, Problem
from ia_bench.methods.couplings.targets import Targets
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import NoPrior, Prior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.readers.native import NativeReader
from ia_bench.render.reconstruction import Reconstruction
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.runs.scene import tell_truth
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer
from ia_bench_baselines.mitsuba_adam.method import MitsubaAdam
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions

METRICS = ("aligned_albedo_psnr", "view_synthesis_psnr", "relighting_psnr", "roughness_mse")


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


def curve_of(method: Method, problem: Problem, scorer: Scorer) -> list[dict[str, float]]:
    """The curve of one fit."""
    clock = Clock(scorer)
    monitor = Monitor.silent(note=print, score=lambda _, step, __, found: clock.score(step, found()))
    result = method.fit(problem, seed=0, monitor=monitor)
    clock.score(result.steps, result.reconstruction)
    return clock.finished()


def ours(steps: int) -> TwoStage:
    """Our two-stage trainer, two thirds of its steps in stage 1 as by default."""
    first = round(steps * 2 / 3)
    return TwoStage(FitSettings(stage1_steps=first, stage2_steps=steps - first, guided=False))


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
    scene = NativeReader(resolve_scene_folder(SceneConfig(arguments.scene))).read(truth=True)
    render = RenderSettings(bounces=0, coat="added")
    problem = Problem(
        scene.blind(),
        render,
        make_prior=lambda problem: tell_truth(prior, scene, problem),
        make_coupling=lambda info: Targets() if info.provides else NoCoupling(),
        note=lambda _: None,
    )
    scorer = Scorer(scene, Protocol(), problem.device)
    plain = {steps: MitsubaAdam(MitsubaAdamOptions(steps=steps)) for steps in arguments.mitsuba_steps}
    curves = {
        "ours": {steps: curve_of(ours(steps), problem, scorer) for steps in arguments.steps},
        "Mitsuba 3": {steps: curve_of(method, problem, scorer) for steps, method in plain.items()},
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
        our, other = times["ours"], times["Mitsuba 3"]
        longest = max(rows[-1]["seconds"] for rows in curves["Mitsuba 3"].values())
        ratio = "-" if our is None else f"{other[0] / our[0]:.1f}" if other else f"> {longest / our[0]:.1f}"
        print(f"| {level:.0f} | {cells[0]} | {cells[1]} | {ratio} |")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        content = {"curves": curves, "environment": environment("cpu", arguments.threads), **vars(arguments)}
        content["out"] = None
        (arguments.out / f"end_to_end_{arguments.prior}.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
