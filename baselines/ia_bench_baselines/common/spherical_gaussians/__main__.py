"""What is lost where lights are given to a method of spherical Gaussians: a row for every lat-long map in EXR.

python -m ia_bench_baselines.common.spherical_gaussians datasets/scenes/*/lights/*.exr datasets/lights/*.exr
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from ia_bench.common.exit_codes import OK, status_of
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.scenes.exr import read_exr
from ia_bench_baselines.common.spherical_gaussians.fit import ROWS, fit_light, residual


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit every light that the command line names, print the errors of its irradiance, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lights", nargs="+", type=Path)
    lights = parser.parse_args(arguments).lights
    return status_of(lambda: _compare(lights))


def _compare(lights: Sequence[Path]) -> int:
    print("| light | irradiance, mean error | worst of 64 normals | power |\n| :--- | ---: | ---: | ---: |")
    for path in lights:
        light = LatLongEnvironment(torch.from_numpy(read_exr(path, 3)))
        lost = residual(light.latlong(ROWS), fit_light(light))
        print(f"| {path} | {lost.mean:.1%} | {lost.worst:.1%} | {lost.energy:+.1%} |", flush=True)
    return OK


if __name__ == "__main__":
    sys.exit(main())
