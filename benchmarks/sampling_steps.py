"""Quality of the diffusion prior against the number of sampling steps and seconds, on images that training never saw.

    python benchmarks/sampling_steps.py FOLDER_OF_HELD_OUT_SHARDS [--weights FOLDER] [--steps 1 2 3 5 10 20 50] [--figure FILE]

One row per number of steps: network evaluations and CPU seconds an image of one sample, aligned albedo (PSNR in dB) of one sample
and of the mean of 8, and how much the mean is below the best row, paired over images with its 95 % interval. The row to
choose is the first that loses less than 0.1 dB.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.priors.diffusion.prior import DiffusionPrior
from ia_bench_training.single_view_scores import SAMPLES, load_examples
from ia_bench_training.validation import aligned_psnr


def main() -> None:
    """Sample, score, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("examples", help="folder of held-out shards, or a scene")
    parser.add_argument("--weights", help="folder of weights (default: the packaged ones)")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 2, 3, 5, 10, 20, 50])
    parser.add_argument("--limit", type=int, default=64, help="images")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="PNG to write")
    arguments = parser.parse_args()
    examples = load_examples(arguments.examples, arguments.limit)
    images, inside = examples.shown.images, examples.shown.masks > 0.5
    count = len(images)

    rows: list[tuple[int, float, float, Tensor, Tensor]] = []
    for steps in arguments.steps:
        prior = DiffusionPrior(weights=arguments.weights, steps=steps)
        prior.sample(examples.shown.select([0]), seed=0)  # loads the weights
        started = time.process_time()
        drawn = [prior.sample(examples.shown, seed=derive_seed(arguments.seed, draw)) for draw in range(SAMPLES)]
        seconds = (time.process_time() - started) / SAMPLES / count
        albedo = torch.stack([samples.values["albedo"] for samples in drawn])
        one, mean = (aligned_psnr(value, examples.albedo, inside, channels=False) for value in (albedo[0], albedo.mean(0)))
        rows.append((steps, sum(samples.cost["network_calls"] for samples in drawn) / SAMPLES / count, seconds, one, mean))
    best = max((mean for *_, mean in rows), key=lambda mean: float(mean.mean()))
    image = float(aligned_psnr(images, examples.albedo, inside, channels=False).mean())
    print(f"{count} images of {examples.name}; the image taken as albedo: {image:.2f} dB\n")
    print(f"| steps | evaluations | CPU seconds | one sample | mean of {SAMPLES} | below the best |\n|" + " ---: |" * 6)
    for steps, calls, seconds, one, mean in rows:
        loss = best - mean
        half = 1.96 * float(loss.std()) / count**0.5
        cells = [f"{calls:.0f}", f"{seconds:.3f}", f"{one.mean():.2f}", f"{mean.mean():.2f}", f"{loss.mean():.2f} ± {half:.2f}"]
        print(f"| {steps} | " + " | ".join(cells) + " |")
    if arguments.figure:
        plot(arguments.figure, rows, image)


def plot(path: Path, rows: list[tuple[int, float, float, Tensor, Tensor]], image: float) -> None:
    """Aligned albedo against CPU seconds of one sample, the numbers of steps beside the points."""
    figure = Figure(figsize=(5, 3.4), layout="constrained")
    axes = figure.add_subplot()
    seconds = [row[2] for row in rows]
    for label, values in (("one sample", [row[3] for row in rows]), (f"mean of {SAMPLES}", [row[4] for row in rows])):
        axes.plot(seconds, [float(value.mean()) for value in values], marker="o", label=label)
    for steps, _, x, _, mean in rows:
        axes.annotate(str(steps), (x, float(mean.mean())), textcoords="offset points", xytext=(0, 5), ha="center")
    axes.axhline(image, color="grey", linestyle=":", label="the image taken as albedo")
    axes.set(xscale="log", xlabel="CPU seconds an image and sample", ylabel="aligned albedo, PSNR (dB)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend()
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
