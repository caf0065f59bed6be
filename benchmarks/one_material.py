"""How much a recovered albedo varies within an object that is of one material, such as the marble of `alexander`.

    python -m benchmarks.one_material RUN_FOLDER...

Over the object's pixels in the held-out photographs: the standard deviation of log2 of the albedo's grey value, and of its red and
blue over its green, in stops; and the same of the photographs themselves. What a fit leaves of the photographs' variation is
shading that it took for paint, and stains and patina that are there: of two fits the one with less has explained more by light.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from ia_bench.render.stage import Stage
from ia_bench.runs.recovered import Recovered

DARK = 1 / 256
"""What is added to values before their logarithm, of the mean: next to nothing is known of darker ones."""


def variation(values: np.ndarray) -> tuple[float, float]:
    """Standard deviations of grey values and of chromaticities of linear colours (N, 3), in stops."""
    values = np.maximum(values, 0) + DARK * values.mean()
    grey, chroma = np.log2(values.mean(1)), np.log2(values[:, [0, 2]] / values[:, 1:2])
    return float(grey.std()), float(np.sqrt(chroma.var(0).mean()))


def measured(folder: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    """:func:`variation` of a run's albedo, and of the held-out photographs in the same pixels."""
    run = Recovered(folder)
    scene = run.read_scene()
    views = [view for view in scene.novel if view.light == "train"] or list(scene.test)
    recovered = run.reconstruction(Stage(scene.expect_mesh(), torch.device("cpu")))
    albedo = recovered.maps([view.camera for view in views], ["albedo"], points=2)["albedo"]
    inside = [(view.mask > 0.99) & (mask > 0.99) for view, mask in zip(views, albedo.coverage, strict=True)]
    pixels = [np.concatenate([image[where] for image, where in zip(images, inside, strict=True)]) for images in (
        albedo.images, [view.image / view.image[view.mask > 0.99].mean() for view in views]
    )]  # fmt: skip
    return variation(pixels[0]), variation(pixels[1])


def main() -> None:
    """Print a line for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN_FOLDER")
    print("| run | albedo: grey, chromaticity | photographs: grey, chromaticity |\n| :--- | ---: | ---: |")
    for folder in parser.parse_args().runs:
        albedo, photographs = measured(folder)
        print(f"| {folder.name} | {albedo[0]:.2f}, {albedo[1]:.2f} | {photographs[0]:.2f}, {photographs[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
