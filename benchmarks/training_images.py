"""How fast one core makes training images, apart from the start that a worker pays once.

    python benchmarks/training_images.py [--images 64] [--size 64] [--rounds 7] [--shading compiled]

Every round renders the next images of seed 0. Seconds are the process's own CPU time on one thread, which other programs
disturb less than the wall clock does; "start" is the first eight images, with imports' remainder and compilation.
"""

from __future__ import annotations

import argparse
import statistics
import time

import torch

from ia_bench_training.generate import render_images
from ia_bench_training.render import VIEWS
from ia_bench_training.shading import DirectLight


def main() -> None:
    """Time the rounds and print their median and range."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=64, help="a round")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--shading", choices=("compiled", "eager"), default="compiled")
    options = parser.parse_args()

    torch.set_num_threads(1)
    direct = DirectLight(compiled=options.shading == "compiled")
    started = time.process_time()
    render_images(0, 0, VIEWS, options.size, direct)
    print(f"start: {time.process_time() - started:.1f} s of CPU, {VIEWS} images")
    speeds = []
    for number in range(options.rounds):
        started = time.process_time()
        render_images(0, VIEWS + number * options.images, options.images, options.size, direct)
        speeds.append(options.images / (time.process_time() - started))
    print(
        f"{options.images} images of {options.size} x {options.size}, {options.rounds} rounds: median "
        f"{statistics.median(speeds):.1f} images a second of CPU, {min(speeds):.1f} to {max(speeds):.1f}"
    )


if __name__ == "__main__":
    main()
