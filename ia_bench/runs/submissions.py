"""The pictures by which a run is scored, as ``method=images`` reads them, or as the evaluation of Stanford-ORB takes them.

That is scripts/test.py of its repository, for which OUT.json, ``{"info": {CAPTURE: {"view", "light", "geometry", "material",
"shape"}}}``, pairs files below OUT/CAPTURE with files of the dataset. Pictures are linear OpenEXR of SIDE x SIDE pixels with three
channels, divided by their coverage; normals are in the frame of the camera, as the dataset's are, and depths along its axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Begin, unseen
from ia_bench.methods.info import held_out
from ia_bench.render.stage import Stage
from ia_bench.runs.record import json_bytes
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.images import Images, straight
from ia_bench.scenes.scene import Scene, View
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.scorer import Scorer

SIDE = 512  # pixels of the pictures that the evaluation takes
READER = "ia_bench.readers.stanford_orb:StanfordOrbReader"
DATA = "data/stanfordorb"
"""Where the evaluation's own example has the dataset, below the folder that it is started in."""

Pairs = dict[str, Any]


def write_predictions(run: Path, out: Path) -> dict[str, int]:
    """Draw what the run in a folder recovered, of every view that is scored, and write it below ``out``.

    FOLDER/VIEW.exr, linear, premultiplied, with the coverage as alpha, in the folders of :mod:`ia_bench.methods.images`; novel
    lights show the aligned albedo. Returns the number of pictures by folder. Raises InputError for a run that has not finished, has
    left no textures, or is of another scene than the one that is there.
    """
    found = Recovered(run)
    scene = found.read_scene()
    if not found.has("albedo.exr"):
        raise InputError(f"{run}: expected a run with textures (albedo.exr), found none: its pictures are not kept")
    make_writable(out, "--pictures")
    _, drawn = _drawn(found, scene)
    folders: dict[str, Images | None] = {name: getattr(drawn, name) for name in ("albedo", "roughness", "view_synthesis")}
    folders |= {f"relighting/{light}": images for light, images in (drawn.relighting or {}).items()}
    written: dict[str, int] = {}
    for folder, images in folders.items():
        for (name, _), image, alpha in zip(held_out(scene)[folder], images.images, images.coverage, strict=True) if images else ():
            colours = np.broadcast_to(image if image.ndim == 3 else image[..., None], (*alpha.shape, 3))
            write_exr(out / folder / f"{name}.exr", np.dstack([colours, alpha]), half=False)
            written[folder] = written.get(folder, 0) + 1
    return written


def write_submission(folders: Sequence[Path], out: Path, *, data: str = DATA, begin: Begin = unseen) -> Path:
    """Draw what runs recovered, one a capture, below ``out``, and return the file that says which is what.

    Paths in the file begin as ``out`` and ``data``, the dataset's folder, are given here: the evaluation opens them as they are.
    Raises InputError for runs of several rows, for two of a capture, and for one of another dataset or picture size.
    """
    runs = [Recovered(folder) for folder in folders]
    rows = sorted({run.record.row for run in runs})
    if len(rows) > 1:
        raise InputError(
            f"expected runs of one row, since a submission is of one method, found {', '.join(rows)}; --row NAME chooses"
        )
    bar, info = begin("captures", len(runs)), dict[str, Pairs]()
    for run in runs:
        options = run.config.reader.options
        capture = str(options.get("capture"))
        if run.config.reader.target != READER:
            raise InputError(f"{run.folder}: expected a run with reader=stanford_orb, found reader={run.config.reader.name}")
        if capture in info:
            raise InputError(f"{run.folder}: expected one run of {capture}, found a second one: give those of one seed")
        info[capture] = _capture(run, out / capture, f"{data}/blender_HDR", f"{data}/ground_truth/{capture}", capture)
        bar.advance()
    file = out.with_name(f"{out.name}.json")
    with whole_file(file) as partial:
        partial.write_bytes(json_bytes(file.name, {"info": info}))
    return file


def _capture(run: Recovered, out: Path, photographs: str, truth: str, capture: str) -> Pairs:
    """Write what a run recovered of a ``capture`` into ``out``, and return the list's entry; what is not there is null."""
    scene = run.read_scene()
    size = (scene.test[0].camera.width, scene.test[0].camera.height)
    if size != (SIDE, SIDE):
        raise InputError(
            f"{run.folder}: expected views of {SIDE} x {SIDE} pixels (reader.options.shrink=4), found {size[0]} x {size[1]}"
        )
    stage, drawn = _drawn(run, scene)
    test, seen = scene.test, [view for view in scene.novel if view.light == "train"]

    def pair(name: str, images: Images | None, number: int, target: str) -> Pairs:
        written = None if images is None else _write(out / name, straight(images.images[number], images.coverage[number]))
        return {"output_image": written, "target_image": target}

    def masked(view: View) -> Pairs:
        return {"target_mask": f"{photographs}/{capture}/test_mask/{view.name}.png"}

    def photograph(place: str, view: View) -> str:
        return f"{photographs}/{place}/test/{view.name.rpartition('_')[2]}.exr"

    lit = [(view, (drawn.relighting or {}).get(view.light)) for view in scene.novel if view.light != "train"]
    shape, mesh = out / "mesh.obj", stage.mesh
    shape.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(shape) as partial, partial.open("w") as obj:
        np.savetxt(obj, mesh.vertices, "v %.7g %.7g %.7g")
        np.savetxt(obj, mesh.faces + 1, "f %d %d %d")
    return {
        "view": [pair(f"view/{v.name}.exr", drawn.view_synthesis, n, photograph(capture, v)) for n, v in enumerate(seen)],
        "light": [pair(f"light/{v.name}.exr", images, 0, photograph(v.light.rpartition("_")[0], v)) for v, images in lit],
        "geometry": [_geometry(stage, view, out, truth) | masked(view) for view in test],
        "material": [
            pair(f"albedo/{v.name}.exr", drawn.albedo, n, f"{truth}/pseudo_gt_albedo/{v.name}.png") | masked(v)
            for n, v in enumerate(test)
        ],
        "shape": {"output_mesh": str(shape), "target_mesh": f"{truth}/mesh_blender/mesh.obj"},
    }


def _drawn(run: Recovered, scene: Scene) -> tuple[Stage, Predictions]:
    """The mesh of a run's scene, and the pictures by which the run is scored, drawn on the CPU."""
    stage = Stage(scene.expect_mesh(), torch.device("cpu"))
    return stage, Scorer(scene, run.config.protocol, stage.device).pictures(run.reconstruction(stage))


def _geometry(stage: Stage, view: View, out: Path, truth: str) -> Pairs:
    """Write unit normals (H, W, 3) in the frame of the camera and depths (H, W) along its axis, 0 where it sees no mesh."""
    camera, gbuffer = view.camera, stage.gbuffer([view.camera], 1)
    points = stage.surface(gbuffer.face[:, 0], gbuffer.barycentric[:, 0], gbuffer.seen_from())
    normal, position = (gbuffer.images(values)[0].cpu().numpy().astype(np.float64) for values in (points.normal, points.position))
    there = gbuffer.coverage()[0].cpu().numpy() > 0
    depth = np.where(there, (camera.position - position) @ camera.to_world[:3, 2], 0)
    return {
        "output_depth": _write(out / "depth" / f"{view.name}.exr", depth),
        "target_depth": f"{truth}/z_depth/{view.name}.npy",
        "output_normal": _write(out / "normal" / f"{view.name}.exr", normal @ camera.to_world[:3, :3]),
        "target_normal": f"{truth}/surface_normal/{view.name}.npy",
    }


def _write(path: Path, image: np.ndarray) -> str:
    write_exr(path, image.astype(np.float32), half=False)
    return str(path)
