"""One optimisation step, the image and the gradients of albedo, roughness and light: ours beside torch's and Mitsuba 3's.

    python benchmarks/gradient_step.py --threads 1   # ours, and Mitsuba's where it is (pip install mitsuba==3.9.1, libLLVM)

The object, textures and light of a shipped scene; light and BRDF sampling joined by the balance heuristic, shadows. "torch,
compiled" is our estimator written in torch (benchmarks/reference.py) under torch.compile, where there is a C++ compiler.

1. *Per sample*: 4096 random pixels x 32 samples a step. Mitsuba (``llvm_ad_rgb``, ``direct`` with 4 + 4 samples, ``principled``,
   bitmaps, envmap) renders a whole view with as many samples on the object, and once more with 8 times as many, which it
   does at a better rate; and with its ``prb`` integrator of depth 2, which differentiates with detached samples, as we do.
   Times are given per million samples whose camera ray hits the object.
2. *At equal variance*: the gradient of the mean radiance of one view, R times with independent samples, summed over blocks
   of texels, so that where in a pixel a sample falls (ours do not move) counts as no noise, and that Mitsuba spreads a
   sample of the light over four texels (ours are constant) as no gain. Efficiency is
   1 / (relative variance x seconds), and the ratio of efficiencies is how many times sooner the same precision is reached.
   ``bias`` is the squared relative distance of the mean gradient from ours, without the noise of both: that of
   the other BRDF and light.

Cases are taken in turns and CPU seconds of one thread compared, since other programs disturb the wall clock more. The
first runs, which compile, are discarded. With --out the numbers are written to FOLDER/gradient_step.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.mitsuba_scene import TrackedScene
from benchmarks.reference import TorchRenderer, can_compile
from benchmarks.stage import TrueScene
from benchmarks.work_precision.precision import Moments, efficiency, time_in_turns
from ia_bench.common.errors import InputError
from ia_bench.common.machine import environment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba

PIXELS, SAMPLES, VIEWS, SIZE = 4096, 32, 20, 128
LIGHT_UNIFORM = 0.2  # fit.defensive_share
WARM_UP = 3
BLOCK = 8  # texels along a side; at 512 texels a pixel of the default scene spans about 3
MITSUBA = {"direct": (1, 8), "prb": (1,)}  # integrators, and how many times the samples of a step
BOUNCES = 3  # of the step with indirect light (and a layered coat), which Mitsuba has no counterpart for here


class OurStep:
    """The gradient of our image of some pixels, as the two-stage trainer computes it."""

    def __init__(
        self, stage: TrueScene, gbuffer: GBuffer, *, bounces: int = 0, coat: str = "added", torch_compiled: bool = False
    ) -> None:
        self.gbuffer = gbuffer
        renderer = stage.geometry.renderer(bounces=bounces, coat=coat, control_variate=bounces > 0 and not torch_compiled)
        self.renderer = TorchRenderer(renderer, compiled=True) if torch_compiled else renderer
        tensors = stage.material.albedo, stage.material.roughness, stage.light
        self.albedo, self.roughness, self.light = (tensor.clone().requires_grad_() for tensor in tensors)
        self.generator = torch.Generator().manual_seed(0)

    def gradient(self, pixels: Tensor, loss: Callable[[Tensor], Tensor]) -> dict[str, Tensor]:
        """Gradients of ``loss`` of the radiance (P, 3) of G-buffer entries (P,)."""
        light = SampledLight.of(self.light, uniform_fraction=LIGHT_UNIFORM)
        material = Material(self.albedo, self.roughness)
        rendered = self.renderer.render_pixels(self.gbuffer, pixels, material, light, SAMPLES, self.generator)
        loss(rendered.radiance).backward()
        gradients = {name: getattr(self, name).grad for name in ("albedo", "roughness", "light")}
        self.albedo.grad = self.roughness.grad = self.light.grad = None
        return gradients

    def random_step(self, _: int) -> None:
        """A step over PIXELS random pixels."""
        pixels = torch.randint(len(self.gbuffer.pixel), (PIXELS,), generator=self.generator)
        self.gradient(pixels, lambda radiance: (radiance - 0.3).abs().mean())


def per_sample(stage: TrueScene, rounds: int, threads: int, mitsuba: bool) -> dict[str, dict[str, float]]:
    """Milliseconds per million samples of every case: median and best, wall and CPU."""
    cameras = stage.cameras(VIEWS, SIZE)
    gbuffer = stage.gbuffer(cameras)
    steps = {"ours": OurStep(stage, gbuffer)}
    steps[f"ours, {BOUNCES} bounces"] = OurStep(stage, gbuffer, bounces=BOUNCES, coat="layered")
    if can_compile():
        steps["torch, compiled"] = OurStep(stage, gbuffer, torch_compiled=True)
    cases: dict[str, Callable[[int], None]] = {name: step.random_step for name, step in steps.items()}
    samples = dict.fromkeys(cases, float(PIXELS * SAMPLES))
    covered = float(gbuffer.coverage()[0].sum())
    for integrator, factors in MITSUBA.items() if mitsuba else ():
        other = stage.mitsuba(cameras[:1], threads, integrator)
        for factor in factors:
            rays = max(1, round(factor * PIXELS * SAMPLES / (covered * other.samples_per_ray)))

            def step(number: int, other: TrackedScene = other, rays: int = rays) -> None:
                other.track()
                other.dr.backward(other.dr.mean(other.dr.abs(other.render(0, rays, number) - 0.3)))
                other.evaluate_gradients()

            name = f"Mitsuba 3, {integrator}" + (f", {factor} times the samples" if factor > 1 else "")
            cases[name], samples[name] = step, covered * rays * other.samples_per_ray
    times = time_in_turns(cases, rounds, WARM_UP)
    return {
        name: {
            "samples": samples[name],
            **{
                f"{clock}_{kind}_ms": 1e9 * float(pick(seconds)) / samples[name]
                for clock, seconds in zip(("wall", "cpu"), times[name], strict=True)
                for kind, pick in (("median", np.median), ("best", np.min))
            },
        }
        for name in cases
    }


def at_equal_variance(stage: TrueScene, rounds: int, threads: int, mitsuba: bool) -> dict[str, dict[str, float]]:
    """Relative variance, CPU seconds, efficiency and bias of the gradient of one view, per parameter."""
    cameras = stage.cameras(1, SIZE)
    gbuffer = stage.gbuffer(cameras)
    pixels = torch.arange(len(gbuffer.pixel))
    ours = OurStep(stage, gbuffer)
    cases: dict[str, Callable[[int], object]] = {"ours": lambda _: ours.gradient(pixels, Tensor.sum)}
    read: dict[str, Callable[[object], dict[str, np.ndarray]]] = {
        name: lambda gradients: {key: value.numpy() for key, value in gradients.items()} for name in cases
    }
    for integrator in MITSUBA if mitsuba else ():
        other = stage.mitsuba(cameras, threads, integrator)

        def step(number: int, other: TrackedScene = other) -> TrackedScene:
            other.track()
            other.dr.backward(other.dr.sum(other.render(0, SAMPLES // other.samples_per_ray, number)))
            other.evaluate_gradients()
            return other

        cases[f"Mitsuba 3, {integrator}"], read[f"Mitsuba 3, {integrator}"] = step, TrackedScene.gradients
    moments = {name: {key: Moments() for key in ("albedo", "roughness", "light")} for name in cases}

    def keep(name: str, result: object) -> None:
        for key, gradient in read[name](result).items():
            moments[name][key].add(over_blocks(gradient))

    times = time_in_turns(cases, rounds, WARM_UP, keep)
    first = next(iter(cases))
    table = {}
    for name in cases:
        seconds = float(np.median(times[name][1]))
        table[name] = {"cpu_s": seconds, "wall_s": float(np.median(times[name][0]))}
        for key, moment in moments[name].items():
            variance = moment.relative_variance
            table[name][f"{key}_variance"], table[name][f"{key}_efficiency"] = variance, efficiency(variance, seconds)
            table[name][f"{key}_bias"] = moment.relative_distance(moments[first][key]) if name != first else 0.0
    return table


def over_blocks(texture: np.ndarray) -> np.ndarray:
    """Sums over BLOCK x BLOCK texels of (H, W, C)."""
    height, width = (side // BLOCK for side in texture.shape[:2])
    return texture.reshape(height, BLOCK, width, BLOCK, -1).sum((1, 3))


def print_report(speed: dict[str, dict[str, float]], noise: dict[str, dict[str, float]]) -> None:
    """Three tables in Markdown; every ratio is over ours."""
    first = next(iter(speed))
    print("| gradient step | samples | CPU ms per million samples (best) | wall ms | CPU, times ours |")
    print("| :--- | ---: | ---: | ---: | ---: |")
    for name, row in speed.items():
        cpu = f"{row['cpu_median_ms']:.0f} ({row['cpu_best_ms']:.0f})"
        ratio = row["cpu_median_ms"] / speed[first]["cpu_median_ms"]
        print(f"| {name} | {row['samples']:.0f} | {cpu} | {row['wall_median_ms']:.0f} | {ratio:.2f} |")
    keys = ("albedo", "roughness", "light")
    print(f"\n| gradient of one view, {SAMPLES} samples a pixel | CPU ms |", end="")
    print("".join(f" {key}: variance, bias | times sooner than it, ours |" for key in keys))
    print("| :--- | ---: |" + " ---: | ---: |" * len(keys))
    for name, row in noise.items():
        cells = [f"{1e3 * row['cpu_s']:.0f}"]
        for key in keys:
            gain = noise["ours"][f"{key}_efficiency"] / row[f"{key}_efficiency"]
            cells += [f"{row[f'{key}_variance']:.3g}, {row[f'{key}_bias']:.2g}", f"{gain:.2f}"]
        print(f"| {name} | " + " | ".join(cells) + " |")


def main() -> None:
    """Measure, print, and write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="hat", help="a shipped scene")
    parser.add_argument("--light-rows", type=int, default=128)
    parser.add_argument("--threads", type=int, default=1, help="threads of each renderer")
    parser.add_argument("--rounds", type=int, default=20, help="runs of every case")
    parser.add_argument("--no-mitsuba", action="store_true")
    parser.add_argument("--out", type=Path, help="folder for gradient_step.json")
    arguments = parser.parse_args()
    stage = TrueScene.of(arguments.scene, light_rows=arguments.light_rows, threads=arguments.threads)
    mitsuba = not arguments.no_mitsuba
    if mitsuba:
        try:
            import_mitsuba(arguments.threads)
        except InputError as error:
            print(f"{error}\n")
            mitsuba = False
    speed = per_sample(stage, arguments.rounds, arguments.threads, mitsuba)
    noise = at_equal_variance(stage, arguments.rounds, arguments.threads, mitsuba)
    print_report(speed, noise)
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        content = {
            "scene": arguments.scene, "threads": arguments.threads, "rounds": arguments.rounds,
            "per_sample": speed, "at_equal_variance": noise,
            "environment": environment("cpu", arguments.threads),
        }  # fmt: skip
        (arguments.out / "gradient_step.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
