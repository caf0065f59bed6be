"""The pictures by which a run is scored, written as ``method=images`` reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ia_bench.common.errors import InputError
from ia_bench.common.paths import make_writable
from ia_bench.methods.info import held_out
from ia_bench.render.stage import Stage
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.images import Images
from ia_bench.scores.scorer import Scorer


def write_predictions(run: Path, out: Path) -> dict[str, int]:
    """Draw what the run in a folder recovered, of every view that is scored, and write it below ``out``.

    FOLDER/VIEW.exr, linear, premultiplied, with the coverage as alpha, in the folders of :mod:`ia_bench.methods.images`; novel
    lights show the aligned albedo. Returns the number of pictures by folder. Raises InputError for a run that has not finished, has
    left no textures, or is of another scene than the one that is there.
    """
    found = Recovered(run)
    scene = found.read_scene()
    if not (run / "albedo.exr").is_file():
        raise InputError(f"{run}: expected a run with textures (albedo.exr), found none: its pictures are not kept")
    make_writable(out, "--pictures")
    scorer = Scorer(scene, found.config.protocol, torch.device("cpu"))
    drawn = scorer.pictures(found.reconstruction(Stage(scene.expect_mesh(), torch.device("cpu"))))
    folders: dict[str, Images | None] = {name: getattr(drawn, name) for name in ("albedo", "roughness", "view_synthesis")}
    folders |= {f"relighting/{light}": images for light, images in (drawn.relighting or {}).items()}
    written: dict[str, int] = {}
    for folder, images in folders.items():
        for (name, _), image, alpha in zip(held_out(scene)[folder], images.images, images.coverage, strict=True) if images else ():
            colours = np.broadcast_to(image if image.ndim == 3 else image[..., None], (*alpha.shape, 3))
            write_exr(out / folder / f"{name}.exr", np.dstack([colours, alpha]), half=False)
            written[folder] = written.get(folder, 0) + 1
    return written
