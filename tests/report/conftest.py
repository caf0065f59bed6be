"""Synthetic run folders, written as a run writes them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from run_records import write_record
from scored_runs import put_setup

from ia_bench.runs.composition import compose
from ia_bench.runs.identity import identity, setup
from ia_bench.runs.pictures.drawing import SceneRenderer
from ia_bench.runs.pictures.packing import PICTURES, bundle
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene

SCALE = 1.25  # between the albedo of the perfect run and the truth


@pytest.fixture(scope="session")
def write_run_below() -> Callable[..., Path]:
    """A function that writes one run folder below ROOT/runs and returns it."""

    def write(root: Path, row: str, scene: str, seed: int = 0, psnr: float | None = 20.0, **changes: object) -> Path:
        name = f"{row}-{scene}-{seed}".replace("/", "_")
        return write_record(root / "runs" / name, row, psnr, scene, seed, **changes)

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
    scores = {"aligned_albedo": psnr, "view_synthesis": psnr, "relighting": {"psnr": None}, "roughness": {"mse": 0.0}}
    protocol = {"protocol": "paper-v2", "protocol_description": {"alignment": "mean_rgb"}}
    told = {"metrics": scores, "reasons": {"relighting.psnr": "no light"}, "albedo_scales": {"mean_rgb": [SCALE] * 3}}
    write_record(folder, "perfect", scene="tiny", **protocol, **told)
    put_on_scene(folder, tiny_folder)
    return folder
