"""Where one row of a table recovers the albedo better than another one: by the light that a pixel gets, and by where it faces.

    python benchmarks/albedo_by_light.py results/longer_fits --row "diffusion, kernel, four times" --reference "none, four times"

Prints, for every scene, the row's PSNR of aligned albedo less that of the reference (dB, mean over the seeds that both have) over
the pixels of all test views together: all, the tenth and the three tenths that get the least and the most light (radiance over
true albedo), those that face down; then with one scale a channel, as in metrics.json. The mean over scenes is ± 95 % over seeds.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from pathlib import Path

import numpy as np
from recovered_albedo import INSIDE, TestViews, recovered_albedos

from ia_bench.report.collect import collect
from ia_bench.report.statistics import over_scenes
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.record import RunRecord

PER_CHANNEL = "aligned_albedo_per_channel"
FACING_DOWN = -0.5  # upward component of the normal below this
DARK, BRIGHT = 0.1, 0.7  # quantiles of the light


def parts_of(test: TestViews) -> dict[str, np.ndarray]:
    """Which of the (N,) pixels inside the mask are of which part."""
    inside = test.mask > INSIDE
    image, normal = (np.stack([getattr(view, name) for view in test.views])[inside] for name in ("image", "normal"))
    light = image.mean(-1) / np.maximum(test.albedo[inside].mean(-1), 0.01)
    dark, bright = np.quantile(light, [DARK, BRIGHT])
    everything = np.ones(len(light), dtype=bool)
    return {"all": everything, "darkest tenth": light < dark, "brightest": light >= bright, "down": normal[:, 2] < FACING_DOWN}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="folder of a table")
    parser.add_argument("--row", required=True)
    parser.add_argument("--reference", required=True)
    arguments = parser.parse_args()
    rows = (arguments.row, arguments.reference)
    runs = [run for run in collect(find_run_folders(arguments.results)).runs if run.row in rows]
    for row in rows:
        if not any(run.row == row and run.problem is None for run in runs):
            parser.error(f"{arguments.results}: expected finished runs of row {row!r}, found none")
    found: dict[str, dict[str, dict[tuple[str, int], float]]] = defaultdict(lambda: defaultdict(dict))
    for run, test, albedo in recovered_albedos(runs):
        inside = test.mask > INSIDE
        error = ((albedo - test.albedo)[inside] ** 2).mean(-1)
        for part, pixels in parts_of(test).items():
            found[part][run.scene][run.row, run.seed] = -10 * math.log10(error[pixels].mean())
        variants = RunRecord.read(run.folder).variants
        found["one scale a channel"][run.scene][run.row, run.seed] = variants[PER_CHANNEL]["psnr"]
    scenes = sorted({run.scene for run in runs})
    print("| aligned albedo, dB | " + " | ".join(scenes) + " | mean |\n| :--- |" + " ---: |" * (len(scenes) + 1))
    for part, by_scene in found.items():
        differences = []
        for values in (by_scene[scene] for scene in scenes):
            seeds = sorted(seed for row, seed in values if row == rows[0] and (rows[1], seed) in values)
            differences.append([values[rows[0], seed] - values[rows[1], seed] for seed in seeds])
        estimate = over_scenes(differences)
        if estimate is None:
            parser.error(f"{arguments.results}: expected both rows with the same seeds on some scene, found none")
        cells = [f"{np.mean(seeds):+.2f}" if seeds else "-" for seeds in differences]
        width = "" if estimate.half_width is None else f" ± {estimate.half_width:.2f}"
        print(f"| {part} | " + " | ".join(cells) + f" | {estimate.mean:+.2f}{width} |")


if __name__ == "__main__":
    main()
