"""What limits the view synthesis of a capture: how well other photographs show a held-out one, over the shape that a run had.

    python -m benchmarks.photographs_of_one_shape RUN_FOLDER... [--every 3]

Every pixel of a held-out photograph that the shape fills is looked up in the training photographs that see it well, and compared in
the object's pixels, sRGB after the 99th percentile of the photographs:

- *nearest*: the photograph from the direction nearest to the pixel's; *four*: the mean of the nearest four. Shape and poses
  bound it: no light and no material is asked.
- *one paint*: the mean of all that see it, the best that a surface can do that looks the same from everywhere.
- *render*: what the run recovered, where it covers the object; *with holes*: with black where it does not, as scores have it;
  *exposed*: where it covers, after one factor for each photograph.

What lies between *one paint* and *nearest* is the light that moves, shine and shape finer than the mesh: the fit's to explain.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from ia_bench.common.arguments import at_least
from ia_bench.geometry.hull import looked_up
from ia_bench.render.gbuffer import sees
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import View

WHOLE = 0.95  # coverage from which a pixel shows nothing but the object
COLUMNS = "nearest", "four", "one paint", "render", "with holes", "exposed"


def decibels(one: np.ndarray, other: np.ndarray) -> float:
    """PSNR of linear colours (N, 3), the second of which is the photograph's, in units of its white."""
    return float(-10 * np.log10(np.square(linear_to_srgb(one.clip(0, 1)) - linear_to_srgb(other.clip(0, 1))).mean()))


def measured(view: View, train: list[View], stage: Stage, recovered: TexturedReconstruction, white: float) -> list[float]:
    """The COLUMNS of one held-out ``view``."""
    gbuffer = stage.gbuffer([view.camera], 1)
    hit = gbuffer.face[:, 0] >= 0
    points = stage.surface(gbuffer.face[hit, 0].long(), gbuffer.barycentric[hit, 0], gbuffer.seen_from(hit))
    seen = sees([other.camera for other in train], points.position, points.geometric, stage.rays, stage.surface.offset)
    colours, cosines = torch.zeros(len(points.position), len(train), 3), torch.full(seen.shape, -2.0)
    for place, other in enumerate(train):
        picture = np.concatenate([other.image, other.mask[..., None]], -1)
        found = looked_up(other.camera, torch.from_numpy(picture).float().permute(2, 0, 1), points.position)[0].T
        toward = points.position.new_tensor(other.camera.position) - points.position
        cosine = (toward / toward.norm(dim=1, keepdim=True) * points.view).sum(1)
        usable = seen[:, place] & (found[:, 3] > WHOLE)
        colours[:, place], cosines[:, place] = found[:, :3], torch.where(usable, cosine, -2.0)

    def mean_of(count: int) -> np.ndarray:
        best = cosines.topk(min(count, len(train)), 1)
        weight = (best.values > -2).float()[..., None]
        return ((colours.gather(1, best.indices[..., None].expand(-1, -1, 3)) * weight).sum(1) / weight.sum(1).clamp_min(1)).numpy()

    pixel = gbuffer.pixel[hit].numpy()
    known = (cosines > -2).any(1).numpy() & (view.mask.reshape(-1)[pixel] > WHOLE)
    photograph = view.image / (view.exposure or 1) / white
    shown = photograph.reshape(-1, 3)[pixel][known]
    drawn = recovered.render([view.camera], light=None, albedo_scale=None, quality=Quality(2, 64))
    assert drawn is not None
    render, inside = drawn.images[0] / white, view.mask > WHOLE
    covered = inside & (drawn.coverage[0] > 0.99)
    own, true = render[covered], photograph[covered]
    factor = (own * true).sum() / np.square(own).sum() if own.any() else 1.0
    warped = [decibels(mean_of(count)[known] / white, shown) for count in (1, 4, len(train))]
    return [*warped, decibels(own, true), decibels(render[inside], photograph[inside]), decibels(factor * own, true)]


def main() -> None:
    """Print a line for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--every", type=at_least(1), default=1, help="so many-th of the held-out photographs")
    options = parser.parse_args()
    print(f"| run | {' | '.join(COLUMNS)} |\n| :--- |{' ---: |' * len(COLUMNS)}")
    for folder in options.runs:
        run = Recovered(folder)
        scene = run.read_scene()
        stage = Stage(scene.expect_mesh(), torch.device("cpu"))
        recovered, train = run.reconstruction(stage), list(scene.train)
        white = max(float(np.percentile(view.image[view.mask > 0.5], 99)) for view in train)
        views = [view for view in scene.novel if view.light == "train"] or list(scene.test)
        of_views = [measured(view, train, stage, recovered, white) for view in views[:: options.every]]
        print(f"| {scene.name}, {run.record.row} | {' | '.join(f'{mean:.1f}' for mean in np.nanmean(of_views, 0))} |", flush=True)


if __name__ == "__main__":
    main()
