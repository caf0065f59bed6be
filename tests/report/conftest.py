"""Synthetic run folders, written as a run writes them."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from scored_runs import put_setup

from ia_bench.runs.composition import compose
from ia_bench.runs.identity import identity, setup
from ia_bench.runs.pictures.drawing import SceneRenderer
from ia_bench.runs.pictures.packing import PICTURES, bundle
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene

TRIPLES = ("albedo", "aligned_albedo", "view_synthesis", "relighting")
SCALE = 1.25  # between the albedo of the perfect run and the truth
HEADER = "stage,step,seconds,albedo_psnr,aligned_albedo_psnr,view_synthesis_psnr,relighting_psnr,roughness_mse"


@pytest.fixture(scope="session")
def write_run_below() -> Callable[..., Path]:
    """A function that writes one run folder below ROOT/runs and returns it."""

    def write(root: Path, row: str, scene: str, seed: int = 0, psnr: float | None = 20.0, **changes: object) -> Path:
        """``changes`` replace top-level keys of metrics.json; ``curve`` is the text of curve.csv below its header."""
        folder = root / "runs" / f"{row}-{scene}-{seed}".replace("/", "_")
        folder.mkdir(parents=True)
        curve = changes.pop("curve", None)
        metrics = {name: {"psnr": psnr, "ssim": 0.9, "lpips": 0.1} for name in TRIPLES} | {"roughness": {"mse": 0.05}}
        data = {
            "schema": 2,
            "row": row,
            "scene": scene,
            "seed": seed,
            "protocol": "paper-v1",
            "protocol_description": {"lpips": {"net": "alex"}},
            "config_hash": "0" * 8,
            "status": "ok",
            "sees_truth": False,
            "metrics": metrics,
            "reasons": {f"{name}.psnr": "undefined" for name in TRIPLES} if psnr is None else {},
            "per_image": {},
            "time_s": {"total": 60.0, "bake": 5.0, "prior": 0.0, "stage1": 30.0, "stage2": 15.0, "score": 10.0},
            "peak_memory_bytes": 2**30,
            "rays": 1000,
            "network_calls": 0,
            "plan": {},
            "environment": {},
            "files": {},
        }
        (folder / "metrics.json").write_text(json.dumps(data | changes))
        if curve is not None:
            (folder / "curve.csv").write_text(f"{HEADER}\n{curve}")
        return folder

    return write


@pytest.fixture
def write_run(write_run_below: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """The same, below tmp_path/runs."""
    return partial(write_run_below, tmp_path)


@pytest.fixture(scope="session")
def put_on_scene() -> Callable[[Path, Path], None]:
    """A function that makes a run folder's config.json say that the run was on a scene folder."""

    def put(run: Path, scene: Path) -> None:
        config = compose(["prior=none", "render.coat=layered", f"scene.name={scene.name}", f"scene.path={scene}"], here=False)
        content = identity(config)
        put_setup(run, content, **setup(config))

    return put


@pytest.fixture(scope="session")
def keep_pictures() -> Callable[..., None]:
    """A function that writes the pictures.zip of run folders, all of one scene, from the textures in them."""

    def keep(*folders: Path) -> None:
        runs = [Recovered(folder) for folder in folders]
        renderer = SceneRenderer(runs[0].read_scene(whole=True))
        truth = renderer.truth(turned=False)
        for run in runs:
            found = run.reconstruction(renderer.stage)
            packed = bundle(renderer, truth, found, renderer.recovered(found, run.scale))
            (run.folder / PICTURES).write_bytes(packed.zipped())

    return keep


@pytest.fixture
def perfect_run(tmp_path: Path, tiny: Scene, tiny_folder: Path, put_on_scene: Callable[[Path, Path], None]) -> Path:
    """The folder of a run that recovered everything up to the one scale that cannot be known."""
    truth = tiny.truth
    folder = tmp_path / "run"
    write_exr(folder / "albedo.exr", truth.albedo / SCALE, half=False)
    write_exr(folder / "roughness.exr", truth.roughness, half=False)
    write_exr(folder / "light.exr", truth.lights["train"] * SCALE, half=False)
    psnr = {"psnr": 40.0, "ssim": 1.0}
    metrics = {
        "schema": 2,
        "status": "ok",
        "protocol": "paper-v2",
        "config_hash": "0",
        "reasons": {"relighting.psnr": "no light"},
        "row": "perfect",
        "scene": "tiny",
        "seed": 0,
        "protocol_description": {"alignment": "mean_rgb"},
        "albedo_scales": {"mean_rgb": [SCALE] * 3},
        "plan": {"needed": [{"what": "render.bounces", "value": 2}]},
        "metrics": {"aligned_albedo": psnr, "view_synthesis": psnr, "relighting": {"psnr": None}, "roughness": {"mse": 0.0}},
    }
    (folder / "metrics.json").write_text(json.dumps(metrics))
    put_on_scene(folder, tiny_folder)
    return folder
