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
import torch
from scipy.ndimage import gaussian_filter

from ia_bench.config import SceneConfig, resolve_scene_folder
from ia_bench.render.gbuffer import SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import EmbreeRays
from ia_bench.render.renderer import texture_images
from ia_bench.report.collect import collect, find_run_folders
from ia_bench.report.recovered import read_run
from ia_bench.report.statistics import over_seeds
from ia_bench.scenes.native import load_scene

BLUR = 2.0  # pixels
INSIDE = 0.99  # coverage of a pixel that counts


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
    runs = [run for run in collect(find_run_folders(parser.parse_args().results)).runs if run.problem is None]
    found: dict[str, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for name in sorted({run.scene for run in runs}):
        folder = resolve_scene_folder(SceneConfig(name=name))
        assert folder is not None
        scene = load_scene(folder, truth=True)
        views = [view for view in scene.test if view.albedo is not None]
        surface = SurfaceInterpolator(scene.mesh, torch.device("cpu"))
        gbuffer = trace_gbuffer([view.camera for view in views], EmbreeRays(scene.mesh), 2, torch.device("cpu"))
        mask = gbuffer.coverage().numpy()
        true = detail(np.stack([view.albedo for view in views if view.albedo is not None]), mask)
        for run in runs:
            if run.scene == name:
                recovered, _ = read_run(run.folder, folder)
                albedo = texture_images(surface, gbuffer, recovered.scale * recovered.material.albedo).numpy()
                mine = detail(albedo, mask)
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
