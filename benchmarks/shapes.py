"""How good a surface each kind of ``capture.geometry`` makes of a scene's training views, and how long it takes.

    python -m benchmarks.shapes hat ship console figurine --out docs/results/geometry/shapes.csv

Scored as a run scores it (docs/captures.md#scores-on-another-shape). Nothing is taken from the cache.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import time
from contextlib import nullcontext
from itertools import product
from pathlib import Path

import torch

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import MADE, CaptureSettings, SdfSettings
from ia_bench.readers.native import NativeReader
from ia_bench.render.stage import Stage
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scores.scorer import score_geometry

MASK_THRESHOLD = 0.5  # as in protocol paper-v2
COLUMNS = ("normals_degrees", "depth", "chamfer", "mask_iou", "missed_share")
PLAIN = SdfSettings()


def main() -> None:
    """Print a line for each scene and kind, and write them as CSV."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--kinds", nargs="+", default=MADE, choices=MADE)
    parser.add_argument("--cells", type=int, default=PLAIN.cells)
    parser.add_argument("--steps", type=int, default=PLAIN.steps)
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
            found = measured(folders[name], kind, SdfSettings(options.cells, options.steps))
            line = [name, kind, *(f"{value:.5g}" if isinstance(value, float) else value for value in found.values())]
            print(*line, sep="  ", flush=True)
            if writer:
                writer.writerow(line)
                file.flush()  # so that what was measured is kept, whatever comes next


def measured(folder: Path, kind: str, sdf: SdfSettings) -> dict[str, float | int | None]:
    """Scores and seconds of the mesh that is made of the scene in ``folder``."""
    scene = NativeReader(folder).read(truth=True)
    with tempfile.TemporaryDirectory() as empty:
        os.environ["IA_BENCH_CACHE"] = empty
        settings = CaptureSettings(geometry=kind, sdf=sdf)  # type: ignore[arg-type]
        began = time.perf_counter()
        made = captured(scene, settings, lambda line: None).expect_mesh()
        seconds = time.perf_counter() - began
    found = score_geometry(Stage(made, torch.device("cpu")), scene.mesh, scene.test or scene.novel, MASK_THRESHOLD)
    return {**{column: found[column] for column in COLUMNS}, "seconds": seconds, "threads": torch.get_num_threads()}


if __name__ == "__main__":
    main()
