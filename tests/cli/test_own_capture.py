"""Scenes that lack a part of their truth, and photographs as a phone leaves them: JPEG and masks, no mesh, no splits."""

import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from coarse import COARSE
from PIL import Image
from spoils import Spoil, edited

from ia_bench.readers.writers.frames import write_nerfstudio
from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.scenes.scene import Scene


def without_albedo(folder: Path) -> None:
    edited("scene.json", lambda scene: scene["truth_textures"].pop("albedo"))(folder)
    for split in ("train", "test"):
        edited(f"transforms_{split}.json", lambda content: [frame.pop("albedo_path") for frame in content["frames"]])(folder)


def without_anything(folder: Path) -> None:
    edited("scene.json", lambda scene: [scene.pop(key) for key in ("lights", "truth_textures", "splits")])(folder)
    for split in ("test", "novel"):
        (folder / f"transforms_{split}.json").unlink()
    for part in ("truth", "lights"):
        shutil.rmtree(folder / part)
    keys = ("albedo_path", "specular_path")
    edited("transforms_train.json", lambda content: [frame.pop(key) for frame in content["frames"] for key in keys])(folder)


UNTOLD = {"aligned_albedo", "albedo_error", "light", "log_light"}  # of which no line is told beside the others


@pytest.mark.parametrize(
    ("strip", "lacking"),
    [
        (without_albedo, {"albedo", "aligned_albedo", "albedo_error", "relighting"}),
        (without_anything, {"view_synthesis", "roughness", "relighting", "albedo", *UNTOLD}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_scene_without_a_part_runs(
    tiny_copy: Path, tmp_path: Path, strip: Spoil, lacking: set[str], capfd: pytest.CaptureFixture[str]
) -> None:
    strip(tiny_copy)
    words = ["device=cpu", "threads=1", "preset=smoke", "fit.stage1_steps=2", "fit.stage2_steps=1", f"out={tmp_path / 'out'}"]
    metrics, _ = execute(compose([*words, f"scene.path={tiny_copy}"]))
    assert metrics.status == "ok"
    for component, values in metrics.metrics.items():
        for name, value in values.items():
            if component in lacking:
                assert value is None
                assert metrics.reasons[f"{component}.{name}"]
            else:
                assert math.isfinite(value)
    told = {line.partition(" will")[0] for line in capfd.readouterr().err.splitlines() if " will not be scored: " in line}
    assert told == lacking - UNTOLD


def write_capture(folder: Path, scene: Scene) -> None:
    """transforms.json, images/*.jpg of one exposure, masks/*.png: no mesh, and nothing is held out."""
    train, test = (tuple(replace(view, image=0.75 * view.image) for view in views) for views in (scene.train, scene.test))
    write_nerfstudio(folder, replace(scene, train=train, test=test, novel=()))
    (folder / "mesh.obj").unlink()
    for path in sorted((folder / "images").iterdir()):
        Image.open(path).save(path.with_suffix(".jpg"), quality=92)
        path.unlink()

    def change(content: dict[str, Any]) -> None:
        del content["train_filenames"], content["test_filenames"]
        for frame in content["frames"]:
            frame["file_path"] = frame["file_path"].replace(".png", ".jpg")

    edited("transforms.json", change)(folder)


@pytest.mark.slow
def test_a_folder_of_photographs_gives_an_asset_a_light_and_scores(tiny: Scene, tmp_path: Path) -> None:
    folder, out = tmp_path / "mine", tmp_path / "run"
    write_capture(folder, tiny)
    small = ["preset=smoke", "capture.sdf.cells=48", "capture.sdf.steps=20", "capture.triangles=2000", *COARSE[:2]]
    words = ["reader=nerfstudio", f"scene.path={folder}", "capture.geometry=sdf", "prior=combined", "threads=1", f"out={out}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "IA_BENCH_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "ia_bench", *words, *small]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=1200, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    found = json.loads((out / "metrics.json").read_text())
    assert (found["capture"]["views"], found["capture"]["geometry"]) == (17, "sdf")  # of 20, every 8th is held out
    assert found["metrics"]["view_synthesis"]["psnr"] > 12
    for component in ("albedo", "aligned_albedo", "relighting"):
        assert found["metrics"][component]["psnr"] is None
    assert found["metrics"]["roughness"]["mse"] is None
    written = {path.name for path in out.iterdir()}
    assert {"asset.glb", "pictures.zip"} <= written
    assert "no pictures" not in done.stdout + done.stderr
    assert any("light" in name for name in written), written
