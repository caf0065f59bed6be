"""A scene without a part of its truth runs as any other, and says what cannot be scored and why."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute

Strip = Callable[[Path], Any]


def edit(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def without_albedo(folder: Path) -> None:
    edit(folder / "scene.json", lambda scene: scene["truth_textures"].pop("albedo"))
    for split in ("train", "test"):
        edit(folder / f"transforms_{split}.json", lambda content: [frame.pop("albedo_path") for frame in content["frames"]])


def without_anything(folder: Path) -> None:
    edit(folder / "scene.json", lambda scene: [scene.pop(key) for key in ("lights", "truth_textures", "splits")])
    for split in ("test", "novel"):
        (folder / f"transforms_{split}.json").unlink()
    for part in ("truth", "lights"):
        shutil.rmtree(folder / part)
    keys = ("albedo_path", "specular_path")
    edit(folder / "transforms_train.json", lambda content: [frame.pop(key) for frame in content["frames"] for key in keys])


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
    tiny_copy: Path, tmp_path: Path, strip: Strip, lacking: set[str], capfd: pytest.CaptureFixture[str]
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
