"""Scenes that lack a part of their truth, and photographs as a phone leaves them: JPEG and masks, no mesh, no splits."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from spoils import Spoil, edited

from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene, View


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
def test_a_scene_without_a_part_still_runs(
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


SMALL = [
    "preset=smoke", "capture.sdf.cells=48", "capture.sdf.steps=20", "capture.triangles=2000", "protocol.map_points=2",
    "protocol.render_points=2",
]  # fmt: skip


def write_capture(folder: Path, scene: Scene) -> None:
    """transforms.json, images/*.jpg before a grey wall, masks/*.png of zeros and ones; one exposure for all."""
    views: list[View] = [*scene.train, *scene.test]
    brightest = np.concatenate([(v.image / v.mask.clip(1e-6)[..., None])[v.mask > 0.5].max(-1) for v in scene.train])
    exposure = 1 / np.percentile(brightest, 98)
    frames = []
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
    for number, view in enumerate(views):
        picture = exposure * view.image + 0.3 * (1 - view.mask[..., None])
        codes = np.round(255 * linear_to_srgb(picture.clip(0, 1))).astype(np.uint8)
        Image.fromarray(codes).save(folder / "images" / f"frame_{number:05}.jpg", quality=92)
        Image.fromarray(np.where(view.mask > 0.5, 255, 0).astype(np.uint8)).save(folder / "masks" / f"frame_{number:05}.png")
        frames.append({"file_path": f"images/frame_{number:05}.jpg", "transform_matrix": view.camera.to_world.tolist()})
    camera = views[0].camera
    shared = {"fl_x": camera.focal[0], "fl_y": camera.focal[1], "cx": camera.centre[0], "cy": camera.centre[1]}
    sizes = {"w": camera.width, "h": camera.height, "camera_model": "OPENCV"}
    (folder / "transforms.json").write_text(json.dumps({**shared, **sizes, "frames": frames}))


def command(module: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", module, "reader=nerfstudio", f"scene.path={folder}", *words]
    return subprocess.run(line, capture_output=True, text=True, cwd=folder.parent, timeout=1200, check=False, env=os.environ | {
        "OMP_NUM_THREADS": "1", "IA_BENCH_CACHE": str(folder.parent / "cache"),
    })  # fmt: skip


@pytest.mark.slow
def test_a_folder_of_photographs_gives_an_asset_a_light_and_scores(tiny: Scene, tmp_path: Path) -> None:
    folder, out = tmp_path / "mine", tmp_path / "run"
    write_capture(folder, tiny)
    words = ["capture.geometry=sdf", "prior=combined", "threads=1", f"out={out}", *SMALL]
    done = command("ia_bench", folder, *words)
    assert done.returncode == 0, done.stderr
    found = json.loads((out / "metrics.json").read_text())
    assert (found["capture"]["views"], found["capture"]["geometry"]) == (17, "sdf")  # of 20, every 8th is held out
    assert found["metrics"]["view_synthesis"]["psnr"] > 12
    for component in ("albedo", "aligned_albedo", "relighting"):
        assert found["metrics"][component]["psnr"] is None
    assert found["metrics"]["roughness"]["mse"] is None
    told = done.stdout + done.stderr
    for line in (
        "albedo will not be scored: 3 of 3 test views have no true albedo",
        "roughness will not be scored: 3 of 3 test views have no true roughness",
        "relighting will not be scored: no novel views under another light",
    ):
        assert line in told
    written = {path.name for path in out.iterdir()}
    assert {"asset.glb", "pictures.zip"} <= written
    assert "no pictures" not in told
    assert any("light" in name for name in written), written
