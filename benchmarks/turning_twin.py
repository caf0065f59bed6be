"""Twins of a rendered scene: its object with its true textures under a light that turns, or stands still, by our renderer.

    python -m benchmarks.turning_twin hat figurine --out results/twins

leaves ``hat_static`` and ``hat_turning`` in ``results/twins``, which ``conf/table/turntable.yaml`` reads. Views of the training
light are rendered again (``--samples`` a pixel), and everything else is the scene's. The light of a turning twin goes round the
vertical axis with the camera; the map that the scene has is how it stands for the first photograph.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from ia_bench.capture.settings import CaptureSettings
from ia_bench.capture.turntable import turning_light
from ia_bench.common.paths import scenes_folders
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.readers.native import NativeReader
from ia_bench.readers.writers.frames import write_native
from ia_bench.render.reconstruction import Assets, Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene, View

TURNING = CaptureSettings(light="turntable", turntable_axis=(0.0, 0.0, 1.0))
SPLITS = {"train": 1, "test": 2, "novel": 3}
"""Views of the training light -> the seed of their samples: no two views share any."""


def twin_of(scene: Scene, samples: int, points: int, *, turning: bool) -> Scene:
    """The ``scene`` with our renderer's pictures in place of its own wherever they show the training light."""
    truth = scene.truth
    if truth is None or truth.albedo is None or truth.roughness is None:
        raise SystemExit(f"{scene.source}: expected true textures, found none")
    how = turning_light(scene.train, TURNING, print) if turning else None
    recovered = TexturedReconstruction.of(
        Assets(scene.expect_mesh(), truth.albedo, truth.roughness, truth.metallic), Stage(scene.expect_mesh(), CPU)
    )
    light = LatLongEnvironment(torch.from_numpy(truth.lights["train"]), turning=how)

    def photographed(views: Sequence[View], seed: int) -> tuple[View, ...]:
        lit = [view for view in views if view.light == "train"]
        quality = Quality(points, samples, seed)
        drawn = recovered.render([view.camera for view in lit], light=light, albedo_scale=None, quality=quality)
        assert drawn is not None
        pictures = zip(lit, drawn.images, drawn.coverage, strict=True)
        found = {id(view): replace(view, image=image, mask=mask, specular=None) for view, image, mask in pictures}
        return tuple(found.get(id(view), view) for view in views)

    splits = {split: photographed(getattr(scene, split), seed) for split, seed in SPLITS.items()}
    return replace(scene, name=f"{scene.name}_{'turning' if turning else 'static'}", **splits)


CPU = torch.device("cpu")


def main() -> None:
    """Render the twins that are asked for and not there yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--points", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    for name in given.scenes:
        folder = next(each / name for each in scenes_folders() if (each / name).is_dir())
        for turning in (True, False):
            made = given.out / f"{name}_{'turning' if turning else 'static'}"
            if not made.is_dir():
                write_native(made, twin_of(NativeReader(folder).read(truth=True), given.samples, given.points, turning=turning))
                print(made, flush=True)


if __name__ == "__main__":
    main()
