"""Where the time of scoring one finished run goes: CPU seconds of each part, one thread.

    python benchmarks/scoring.py RUN_FOLDER... [--scene FOLDER] [--protocol paper-v2]

The parts are functions of the package, seen by Python's profiler; "other" is what is left of the total. A row of a run's curve
and all of its scores are measured apart, and a first row too, which reads the baked indirect light and traces what it looks at.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable
from pathlib import Path

import torch

from benchmarks.stage import run_as_a_run
from ia_bench.render.renderer import Renderer, texture_images
from ia_bench.render.stage import Stage
from ia_bench.runs.recovered import Recovered
from ia_bench.scores import comparison, error_split, metrics
from ia_bench.scores.protocol import Protocol, shipped
from ia_bench.scores.scorer import Scorer

PARTS: dict[str, Callable[..., object]] = {
    "G-buffers": Stage.gbuffer,  # that of the split is traced for its surface
    "maps": texture_images,
    "renders": Renderer.render_images,
    "pairs": comparison.Pairs.__getitem__,
    "encoding": comparison.encode,
    "PSNR, MSE": metrics.squared_error,
    "SSIM": metrics.ssim,
    "loading LPIPS": metrics.load,
    "LPIPS": metrics.lpips,
    "surface of the split": error_split.VisibleSurface.of,
    "split of the error": error_split.split,
}


def parts(action: Callable[[], object]) -> dict[str, float]:
    """CPU seconds of ``action`` by part, and in total."""
    profile = cProfile.Profile(time.process_time)
    profile.runcall(action)
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]  # (file, line, name) -> calls, own, with callees, callers
    of = {key: numbers[3] for key, numbers in stats.items()}

    def seconds(function: Callable[..., object]) -> float:
        code = getattr(function, "__wrapped__", function).__code__
        return of.get((code.co_filename, code.co_firstlineno, code.co_name), 0.0)

    found = {name: seconds(function) for name, function in PARTS.items()}
    found["LPIPS"] -= found["loading LPIPS"]  # at the first image
    total = sum(numbers[2] for numbers in stats.values())
    return {**found, "other": total - sum(found.values()), "total": total}


def measure(run: Path, scene_folder: Path | None, protocol: Protocol) -> dict[str, dict[str, float]]:
    """The parts of a first row of the curve, of another one, and of all scores."""
    recovered = Recovered(run)
    scene = recovered.read_scene(scene_folder)
    device = torch.device("cpu")
    scorer = Scorer(scene, protocol, device)
    reconstruction = recovered.reconstruction(Stage(scene.expect_mesh(), device))
    return {
        "first row of a curve": parts(lambda: scorer.quick(reconstruction)),
        "another row": parts(lambda: scorer.quick(reconstruction)),
        "all scores": parts(lambda: scorer.full(reconstruction)),
    }


def main() -> None:
    """Print a table for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN_FOLDER", help="a finished run")
    parser.add_argument("--scene", type=Path, help="folder of the runs' scene, if it is not a shipped one")
    parser.add_argument("--protocol", default=Protocol.name, help="a protocol of conf/protocol (default: %(default)s)")
    wanted = parser.parse_args()
    run_as_a_run(1)
    for run in wanted.runs:
        columns = measure(run, wanted.scene, shipped(wanted.protocol))
        print(f"\n| {run} | {' | '.join(columns)} |\n| :--- |{' ---: |' * len(columns)}")
        for part in next(iter(columns.values())):
            print(f"| {part} | {' | '.join(f'{column[part]:.2f}' for column in columns.values())} |", flush=True)


if __name__ == "__main__":
    main()
