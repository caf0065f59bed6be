"""Where the albedo of a table's rows is wrong: where few photographs show the surface, or many; in its detail, or at large.

    python benchmarks/albedo_errors.py results/value_eight

Squared errors of aligned albedo in sRGB, over all pixels of the test views that the object fills. Prints for every row, from
the mean squares of its runs: the PSNR; for surface that 0, 1, 2 to 3, 4 and more of the run's photographs show, the share of the
pixels, that of the squared error, and the PSNR there; and the share of the squared error that is finer than 1 pixel (what a
Gaussian blur of that deviation takes away), coarser than 4, and between.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from recovered_albedo import INSIDE, TestViews, recovered_albedos
from scipy.ndimage import gaussian_filter

from ia_bench.methods.asking.views import sees
from ia_bench.render.stage import Stage
from ia_bench.report.collect import Run, collect
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.color import linear_to_srgb

SEEN = ((0, 0), (1, 1), (2, 3), (4, 10_000))
"""Least and most photographs of a column."""
FINE, COARSE = 1.0, 4.0  # pixels
OFFSET = 1e-3  # of rays toward the cameras, in scene units


def photographs(run: Run, test: TestViews) -> np.ndarray:
    """How many of the run's training views show what each pixel of the test views shows, (V, H, W); -1 off the object."""
    scene = Recovered(run.folder).read_scene()
    stage = Stage(scene.expect_mesh(), torch.device("cpu"))
    gbuffer = stage.gbuffer([view.camera for view in test.views], 1)
    hit = gbuffer.face[:, 0] >= 0
    points = stage.surface(gbuffer.face[hit, 0].long(), gbuffer.barycentric[hit, 0], gbuffer.seen_from(hit))
    seen = sees([view.camera for view in scene.train], points.position, points.normal, stage.rays, OFFSET)
    counts = torch.full(gbuffer.shape, -1)
    counts.reshape(-1)[gbuffer.pixel[hit]] = seen.sum(1)
    return counts.numpy()


def squares_by_scale(error: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Shares (3,) of the squared ``error`` (V, H, W, 3), zero outside of ``inside``, that are fine, between, and coarse."""

    def smooth(blur: float) -> np.ndarray:
        over = (0, blur, blur)
        share = np.maximum(gaussian_filter(inside.astype(float), over), 1e-3)[..., None]
        smoothed: np.ndarray = gaussian_filter(error, (*over, 0)) / share * inside[..., None]
        return smoothed

    fine, coarse = smooth(FINE), smooth(COARSE)
    parts = np.array([((error - fine) ** 2).sum(), ((fine - coarse) ** 2).sum(), (coarse**2).sum()])
    return parts / parts.sum()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="folder of a table")
    seen, scales = defaultdict(list), defaultdict(list)
    for run, test, albedo in recovered_albedos(collect(find_run_folders(parser.parse_args().results)).runs):
        inside = test.mask > INSIDE
        error = np.where(inside[..., None], linear_to_srgb(albedo.clip(0, 1)) - linear_to_srgb(test.albedo.clip(0, 1)), 0)
        squares, counts = (error**2).mean(-1), photographs(run, test)
        chosen = [inside, *(inside & (counts >= low) & (counts <= high) for low, high in SEEN)]
        seen[run.row].append(np.array([(where.sum(), squares[where].sum()) for where in chosen]) / inside.sum())
        scales[run.row].append(squares_by_scale(error, inside))
    titles = [f"{low}" if low == high else f"{low} to {high}" if high < SEEN[-1][1] else f"{low}+" for low, high in SEEN]
    print(f"| row | dB | {' | '.join(titles)} | finer than {FINE:g} px | {FINE:g} to {COARSE:g} | coarser |")
    print("| :--- " + "| ---: " * (len(SEEN) + 4) + "|")
    for row in seen:
        (_, total), *parts = np.mean(seen[row], 0)
        cells = [f"{-10 * np.log10(total):.1f}"]
        for pixels, square in parts:
            cells.append(f"{pixels:.0%} / {square / total:.0%} / {10 * np.log10(pixels / square):.1f}" if square else "")
        cells += [f"{share:.0%}" for share in np.mean(scales[row], 0)]
        print(f"| {row} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
