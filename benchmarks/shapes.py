"""How good a surface each kind of ``capture.geometry`` makes of a scene's training views, and how long it takes.

    python -m benchmarks.shapes hat ship console figurine --out docs/results/geometry/shapes.csv

Scored as a run scores it (docs/captures.md#scores-on-another-shape). Nothing is taken from the cache. With ``--true-normals`` the
refinement is given those of the true mesh, which no estimate can be better than: an upper bound of ``capture.sdf.normals``.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import time
from contextlib import nullcontext
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import torch

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import MADE, CaptureSettings, SdfSettings
from ia_bench.readers.native import NativeReader
from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.stage import Stage
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene
from ia_bench.scores.scorer import score_geometry

MASK_THRESHOLD = 0.5  # as in protocol paper-v2
COLUMNS = ("normals_degrees", "depth", "chamfer", "mask_iou", "missed_share")
PLAIN = SdfSettings()
SIDE = 2  # rays along a side of a pixel, of true normals


def main() -> None:
    """Print a line for each scene and kind, and write them as CSV."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--kinds", nargs="+", default=MADE, choices=MADE)
    parser.add_argument("--cells", type=int, default=PLAIN.cells)
    parser.add_argument("--steps", type=int, default=PLAIN.steps)
    parser.add_argument("--true-normals", action="store_true")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    folders = {name: resolve_scene_folder(SceneConfig(name)) for name in options.scenes}  # before minutes are spent on the first
    with options.out.open("w", newline="") if options.out else nullcontext() as file:
        writer = csv.writer(file) if file else None
        if writer:
            writer.writerow(["scene", "geometry", *COLUMNS, "seconds", "threads"])
        for name, kind in product(options.scenes, options.kinds):
            found = measured(folders[name], kind, SdfSettings(options.cells, options.steps), true_normals=options.true_normals)
            line = [name, kind, *(f"{value:.5g}" if isinstance(value, float) else value for value in found.values())]
            print(*line, sep="  ", flush=True)
            if writer:
                writer.writerow(line)
                file.flush()  # so that what was measured is kept, whatever comes next


def measured(folder: Path, kind: str, sdf: SdfSettings, *, true_normals: bool = False) -> dict[str, float | int | None]:
    """Scores and seconds of the mesh that is made of the scene in ``folder``."""
    scene = NativeReader(folder).read(truth=True)
    with tempfile.TemporaryDirectory() as empty:
        os.environ["IA_BENCH_CACHE"] = empty
        if true_normals:
            write_normals(Path(empty), scene)
            sdf = replace(sdf, normals=empty)
        settings = CaptureSettings(geometry=kind, sdf=sdf)  # type: ignore[arg-type]
        began = time.perf_counter()
        made = captured(scene, settings, lambda line: None).expect_mesh()
        seconds = time.perf_counter() - began
    found = score_geometry(Stage(made, torch.device("cpu")), scene.mesh, scene.test or scene.novel, MASK_THRESHOLD)
    return {**{column: found[column] for column in COLUMNS}, "seconds": seconds, "threads": torch.get_num_threads()}


def write_normals(folder: Path, scene: Scene) -> None:
    """What each training view sees of the true mesh, as the files of normals that ``capture.sdf.normals`` takes."""
    stage = Stage(scene.expect_mesh(), torch.device("cpu"))
    for view in scene.train:
        origins, directions = (torch.from_numpy(part).reshape(-1, 3) for part in primary_rays(view.camera, SIDE))
        face, barycentric, _ = stage.rays.intersect(origins, directions)
        seen = torch.where((face >= 0)[:, None], stage.surface(face, barycentric, origins).normal, 0).numpy()
        mean = seen.reshape(*view.mask.shape, SIDE * SIDE, 3).mean(2) @ view.camera.to_world[:3, :3]
        length = np.linalg.norm(mean, axis=-1, keepdims=True)
        np.save(folder / f"{view.name}.npy", np.where(length > 0.5, mean / length.clip(0.5), 0).astype(np.float32))


if __name__ == "__main__":
    main()
