"""How time and memory of a fit grow: with pixels x samples of a step, not with the number or the size of the views.

    python benchmarks/scaling.py            # three tables; --quick leaves out all but the smallest views

Every case is the two-stage trainer, without a prior, in a process of its own, so that its peak memory can be read. The
cameras are the training cameras of a shipped scene at other sizes, their images the shipped ones with every pixel repeated:
what the images show is of no matter here. A step's CPU seconds are the median over steps after the first few, which compile.
``bake`` is the G-buffer, made once; its time is that of one primary ray a point.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stage import POINTS, TrueScene, resized
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.settings import RenderSettings
from ia_bench.scenes.scene import Scene

SIZES, VIEWS = (128, 256, 512), (25, 50, 100)
STEPS, COMPILING = 16, 6  # steps of a case, and how many of them are not counted
BASE = {"size": 128, "views": 25, "pixels": 4096, "samples": 32, "texture": 512, "light_rows": 128}
WORK = ((1024, 32), (4096, 8), (4096, 32), (4096, 144), (16384, 32))  # pixels and samples of a step
PAPER = {"texture": 2048, "light_rows": 256, "samples": 144}  # conf/preset/paper.yaml


class StepClock:
    """Counts as the trainer's progress bar and notes the CPU time of every step."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def advance(self, amount: int = 1, **values: float) -> None:
        """See :class:`ia_bench.common.progress.ProgressBar`."""
        self.times.append(time.process_time())


def enlarged(scene: Scene, views: int, size: int) -> Scene:
    """``views`` training views of ``scene``, evenly strided, every pixel repeated until an image is ``size`` pixels wide."""
    chosen = np.linspace(0, len(scene.train) - 1, views).round().astype(int)
    train = []
    for view in (scene.train[index] for index in chosen):
        factor = size // view.camera.width
        image, mask = (a.repeat(factor, 0).repeat(factor, 1) for a in (view.image, view.mask))
        train.append(replace(view, camera=resized(view.camera, size), image=image, mask=mask))
    return replace(scene, train=tuple(train), test=(), novel=()).blind()


def measure(case: dict[str, int], name: str, threads: int) -> dict[str, float]:
    """Run one case in this process: seconds of the bake and of a step, foreground pixels, megabytes at the peak."""
    stage = TrueScene.of(name, light_rows=case["light_rows"], threads=threads)
    scene = enlarged(stage.scene, case["views"], case["size"])
    sizes = {"subsamples": POINTS, "texture": case["texture"], "light_height": case["light_rows"]}
    settings = RenderSettings(case["samples"], **sizes, shadows="traced", bounces=0, coat="added")
    problem = Problem(scene, settings, note=print)
    _ = problem.plan, problem.stage.rays
    started = time.process_time()
    gbuffer = problem.gbuffer
    baked = time.process_time() - started
    clock = StepClock()
    fit = FitSettings(stage1_steps=STEPS, stage2_steps=0, pixels=case["pixels"])
    TwoStage(fit).fit(problem, seed=0, monitor=Monitor.silent(task=lambda *_: clock, note=print))
    return {
        "bake_s": baked,
        "step_ms": 1e3 * statistics.median(np.diff(clock.times)[COMPILING:]),
        "foreground": float(len(gbuffer.pixel)),
        "gbuffer_mb": gbuffer.size_bytes / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
    }


def measure_apart(case: dict[str, int], arguments: argparse.Namespace) -> dict[str, float]:
    """The same in a process of its own."""
    command = [sys.executable, __file__, "--case", json.dumps(case), "--scene", arguments.scene]
    command += ["--threads", str(arguments.threads)]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    result: dict[str, float] = json.loads(output.splitlines()[-1])
    return result


def memory_model(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Least squares of peak MB = base + a x foreground pixels over the cases: (base, a)."""
    design = np.array([[1.0, row["foreground"]] for row in rows])
    base, foreground = np.linalg.lstsq(design, np.array([row["peak_mb"] for row in rows]), rcond=None)[0]
    return float(base), float(foreground)


def table(title: str, rows: Iterable[dict[str, Any]], columns: dict[str, str]) -> list[dict[str, Any]]:
    """Print ``columns`` (key -> format) of the rows in Markdown as they are measured, and return the rows."""
    print(f"\n{title}\n\n| " + " | ".join(columns) + " |\n|" + " ---: |" * len(columns), flush=True)
    kept = []
    for row in rows:
        print("| " + " | ".join(format(row[key], form) for key, form in columns.items()) + " |", flush=True)
        kept.append(row)
    return kept


def main() -> None:
    """Print the tables and write the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="hat", help="a shipped scene")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="the smallest views only")
    parser.add_argument("--out", type=Path, help="folder for scaling.json")
    parser.add_argument("--case", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.case:
        print(json.dumps(measure(json.loads(arguments.case), arguments.scene, arguments.threads)))
        return

    def run(**change: int) -> dict[str, Any]:
        case = BASE | change
        row = case | measure_apart(case, arguments)
        return row | {"ns_a_sample": 1e6 * row["step_ms"] / (row["pixels"] * row["samples"])}

    sizes = SIZES[:1] if arguments.quick else SIZES
    work = table(
        "Pixels x samples of a step (25 views of 128 x 128):",
        (run(pixels=pixels, samples=samples) for pixels, samples in WORK),
        {"pixels": "d", "samples": "d", "step_ms": ".1f", "ns_a_sample": ".0f", "peak_mb": ".0f"},
    )
    geometry = {"size": "d", "views": "d", "foreground": ".0f", "step_ms": ".1f", "bake_s": ".2f"}
    geometry |= {"gbuffer_mb": ".0f", "peak_mb": ".0f"}
    views = table(
        "Views and their size (4096 pixels x 32 samples a step):",
        (run(size=size, views=count) for size in sizes for count in VIEWS),
        geometry,
    )
    paper = table(
        "The paper preset's sizes (2048 x 2048 textures, 256 x 512 light, 144 samples):",
        (run(size=size, views=VIEWS[-1], **PAPER) for size in sizes),
        geometry,
    )
    if len(sizes) > 1:
        base, foreground = memory_model(views)
        print(f"\npeak MB = {base:.0f} + {1e6 * foreground:.0f} B x foreground pixels")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        content = {"work": work, "views": views, "paper": paper}
        (arguments.out / "scaling.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
