"""What is lost where lights are given to a method of spherical Gaussians: a row for every lat-long map in EXR.

python -m ia_bench_baselines.common.spherical_gaussians datasets/scenes/*/lights/*.exr datasets/lights/*.exr
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.scenes.exr import read_exr
from ia_bench_baselines.common.spherical_gaussians.fit import ROWS, fit_light, residual


def main() -> None:
    """Fit every light that the command line names, and print the errors of its irradiance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lights", nargs="+", type=Path)
    print("| light | irradiance, mean error | worst of 64 normals | power |\n| :--- | ---: | ---: | ---: |")
    for path in parser.parse_args().lights:
        light = LatLongEnvironment(torch.from_numpy(read_exr(path, 3)))
        lost = residual(light.latlong(ROWS), fit_light(light))
        print(f"| {path} | {lost.mean:.1%} | {lost.worst:.1%} | {lost.energy:+.1%} |", flush=True)


if __name__ == "__main__":
    main()
