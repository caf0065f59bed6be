"""The renders that are scored, on the smallest shipped scene."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from ia_bench.common.paths import scenes_folder
from ia_bench.material.textures import Material
from ia_bench.readers.native import NativeReader
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene
from ia_bench.scores import components
from ia_bench.scores.predict import Scorer
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.result import Scores

QUICK = Protocol(name="quick", samples_per_pixel=2)


@pytest.fixture(autouse=True)
def no_lpips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its weights are a download."""
    monkeypatch.setattr(components, "lpips", lambda *_, **__: 0.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return NativeReader(scenes_folder() / "tiny").read(truth=True)


def scores(scene: Scene, albedo: float) -> Scores:
    """Of a grey object of one albedo under the true light."""
    assert scene.truth is not None
    stage = Stage(scene.mesh, torch.device("cpu"))
    material = Material(torch.full((8, 8, 3), albedo), torch.full((8, 8, 1), 0.5))
    light = torch.from_numpy(scene.truth.lights["train"])
    return Scorer(scene, stage.renderer(), stage.rays, QUICK, seed=0).full(material, light)


def test_a_novel_light_without_a_map_is_left_out_and_named(scene: Scene) -> None:
    assert scene.truth is not None
    names = sorted({view.light for view in scene.novel} - {"train"})
    assert len(names) >= 2
    unknown = names[0]
    lights = {name: light for name, light in scene.truth.lights.items() if name != unknown}
    whole, part = scores(scene, 0.5), scores(replace(scene, truth=replace(scene.truth, lights=lights)), 0.5)
    key = f"per_image.relighting.{unknown}"
    assert key not in whole.reasons
    assert part.reasons[key] == "left out: the scene has no environment map of this light"
    assert sorted(whole.per_image["relighting"]) == names
    assert part.per_image["relighting"] == {name: whole.per_image["relighting"][name] for name in names[1:]}


def test_without_an_aligned_albedo_relighting_says_why(scene: Scene) -> None:
    black = scores(scene, 0.0)
    assert black.metrics["relighting"]["psnr"] is None
    assert black.reasons["relighting.psnr"] == black.reasons["aligned_albedo.psnr"]
    assert "cannot be aligned" in black.reasons["relighting.psnr"]
