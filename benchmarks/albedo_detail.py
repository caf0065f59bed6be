"""How much of the true albedo's detail the rows of a table recover: what blurs, and what adds detail that is not there.

    python benchmarks/albedo_detail.py results/paper

Recovered and true albedo of every test view, inside the mask, less their own Gaussian blur there (2 pixels). Prints, for every
row, mean over scenes and ± 95 % over seeds: "energy", the standard deviation of the recovered detail (albedo aligned as in the
scores) over that of the true one: below 1 is blur, above is made up; "correlation", 1 where all of it is in its place.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from recovered_albedo import INSIDE, recovered_albedos
from scipy.ndimage import gaussian_filter

from ia_bench.report.collect import collect
from ia_bench.report.statistics import over_seeds
from ia_bench.runs.folder import find_run_folders

BLUR = 2.0  # pixels


def detail(albedo: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """What a blur inside ``mask`` (V, H, W) takes from premultiplied ``albedo`` (V, H, W, 3): (N, 3) of full pixels."""
    over = (0, BLUR, BLUR)
    share = np.maximum(gaussian_filter(mask, over), 1e-3)[..., None]
    blurred = gaussian_filter(albedo, (*over, 0)) / share
    inside = mask > INSIDE
    return (albedo[inside] / mask[inside][:, None]) - blurred[inside]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="folder of a table")
    runs = collect(find_run_folders(parser.parse_args().results)).runs
    found: dict[str, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for run, test, albedo in recovered_albedos(runs):
        mine, true = detail(albedo, test.mask), detail(test.albedo, test.mask)
        found[run.row][run.seed].append((mine.std() / true.std(), np.corrcoef(mine.ravel(), true.ravel())[0, 1]))
    print("| row | energy | correlation |\n| :--- | ---: | ---: |")
    for row, seeds in found.items():
        means = np.array([np.mean(values, 0) for values in seeds.values()])
        cells = []
        for values in means.T.tolist():
            estimate = over_seeds(values)
            assert estimate is not None
            cells.append(f"{estimate.mean:.2f}" + ("" if estimate.half_width is None else f" ± {estimate.half_width:.2f}"))
        print(f"| {row} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
