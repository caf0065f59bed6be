"""A run scored again from its folder: the same protocol gives the same scores, and runs of older code are read."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from coarse import COARSE

from ia_bench.cli.rescore import main
from ia_bench.common.errors import InputError
from ia_bench.facade import Fit
from ia_bench.render.settings import BROUGHT
from ia_bench.report.collect import collect
from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.runs.recovered import Recovered, Rescorer
from ia_bench.scenes.exr import write_exr
from ia_bench.scores.protocol import Protocol

SCORES = ("metrics", "variants", "per_image", "reasons", "counts", "albedo_scales", "protocol", "protocol_description", "renderer")


@pytest.fixture
def old_run(ceiling: Path, tmp_path: Path) -> Path:
    """The same in another folder, to be spoiled."""
    return shutil.copytree(ceiling, tmp_path / "old" / "ceiling")


def record(folder: Path) -> dict:
    return json.loads((folder / "metrics.json").read_text())


def small() -> Protocol:
    return compose(["scene=tiny", *COARSE]).protocol


def test_a_run_on_the_cpu_is_scored_there_beside_a_gpu(ceiling: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Renders of a GPU differ in their last bits, and its new configuration says of the run that it is on the CPU."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    again = Rescorer().rescore(ceiling, small(), tmp_path)
    assert record(again)["metrics"] == record(ceiling)["metrics"]


def test_the_same_protocol_gives_the_same_scores(ceiling: Path, tmp_path: Path) -> None:
    again = Rescorer().rescore(ceiling, small(), tmp_path)
    before, after = record(ceiling), record(again)
    assert {key: after[key] for key in SCORES} == {key: before[key] for key in SCORES}
    for key in ("row", "scene", "seed", "time_s", "rays", "network_calls", "environment", "plan", "sees_truth"):
        assert after[key] == before[key]
    assert after["config_hash"] != before["config_hash"]
    assert after["rescored_from"]["config_hash"] == before["config_hash"]
    assert again.name == f"ceiling-seed3-{after['config_hash'][:8]}"
    (reported,) = collect([again]).runs.to_dict("records")
    assert (reported["problem"], reported["protocol"]) == (None, after["protocol"])
    for name in ("albedo.exr", "pictures.zip"):
        assert (again / name).read_bytes() == (ceiling / name).read_bytes()
    written = (again / "metrics.json").stat().st_mtime_ns
    assert Rescorer().rescore(ceiling, small(), tmp_path) == again
    assert (again / "metrics.json").stat().st_mtime_ns == written  # nothing is scored twice


@pytest.mark.slow
def test_a_run_on_a_hull_is_scored_on_the_mesh_that_is_made_again(tiny_copy: Path, tmp_path: Path) -> None:
    """As a phone would give it: few views, eight bits, exposures that nobody knows, no mesh in the folder."""
    (tiny_copy / "mesh.ply").unlink()
    phone = ["capture.views=12", "capture.radiometry=ldr", "capture.exposure=per_image", "capture.geometry=hull"]
    words = [f"scene.path={tiny_copy}", "preset=smoke", "device=cpu", "threads=1", *COARSE, *phone, "capture.cells=48"]
    execute(compose([*words, "capture.triangles=2000", f"out={tmp_path / 'run'}"]))
    again = Rescorer().rescore(tmp_path / "run", small(), tmp_path / "again", tiny_copy)
    found, scored = record(tmp_path / "run"), record(again)
    assert (scored["metrics"], scored["geometry"]) == (found["metrics"], found["geometry"])
    assert 0 < found["capture"]["saturated_share"] < 0.1
    assert found["geometry"]["mask_iou"] > 0.9
    assert found["metrics"]["view_synthesis"]["psnr"] > 13


def test_what_cannot_be_scored_is_named(ceiling: Path, old_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (old_run / "roughness.exr").unlink()
    with pytest.raises(InputError, match="roughness.exr: no such image"):
        Rescorer().rescore(old_run, small(), tmp_path / "new")
    config = json.loads((old_run / "config.json").read_text())
    config["identity"]["scene"]["content"] = "0" * 64
    (old_run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="the run was on another scene"):
        Rescorer().rescore(old_run, small(), tmp_path / "new")
    assert main([str(old_run), "--out", str(tmp_path / "new")]) == 1
    assert "the run was on another scene" in capsys.readouterr().err
    assert main([str(tmp_path / "nothing"), "--out", str(tmp_path / "new")]) == 2
    shutil.copytree(ceiling, tmp_path / "old" / "new" / "tiny" / "ceiling")
    assert main([str(tmp_path / "old"), "--out", str(tmp_path / "old" / "new")]) == 1
    assert capsys.readouterr().out == "", "what lies in the folder for new runs is not scored again"
    assert main([str(old_run), "--out", str(tmp_path / "new"), "--protocol", "papr"]) == 2
    assert not list((tmp_path / "new").rglob("*.json"))


def test_a_texture_that_another_run_left_is_none_of_the_run(old_run: Path, ceiling: Path, tmp_path: Path) -> None:
    """As one with a metallic texture leaves it that fails behind its fit, before the same folder is used without metal."""
    write_exr(old_run / "metallic.exr", np.ones((8, 8), np.float32), half=False)
    again = Rescorer().rescore(old_run, small(), tmp_path)
    assert record(again)["metrics"] == record(ceiling)["metrics"]
    assert not (again / "metallic.exr").exists()
    assert Fit(old_run).metallic is None


def test_nothing_of_a_scene_that_cannot_be_scored_is_kept(ceiling: Path, tmp_path: Path) -> None:
    """As pictures were brought of one without a mesh: runs behind it were pictured in its views."""
    rescorer, without = Rescorer(), Recovered(ceiling)
    first = rescorer.rescore(ceiling, small(), tmp_path / "first")
    scene = without.read_scene()
    without.config = replace(without.config, scene=replace(without.config.scene, name="other"))
    without.read_scene = lambda _: replace(scene, mesh=None, test=scene.test[:1])  # type: ignore[method-assign]
    with pytest.raises(InputError, match="mesh"):
        rescorer.score(without, small())
    again = rescorer.rescore(ceiling, small(), tmp_path / "again")
    assert (again / "pictures.zip").read_bytes() == (first / "pictures.zip").read_bytes()


def test_a_run_with_a_renderer_of_its_own_is_not_scored_by_another(ceiling: Path, tmp_path: Path) -> None:
    """Its new scores would stand under its row as if its own renderer had made them."""
    folder = shutil.copytree(ceiling, tmp_path / "split sums")
    content = record(folder)
    assert content["renderer"] == "ia_bench reference"
    content["renderer"] = "split sum; under novel lights ia_bench reference"
    (folder / "metrics.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="found split sum; .*: its own renderer is gone; run it again with protocol=paper-v3$"):
        Rescorer().rescore(folder, small(), tmp_path / "new")
    assert not list((tmp_path / "new").rglob("*.json"))


def test_pictures_that_were_brought_and_not_kept_cannot_be_scored_again(ceiling: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(ceiling, tmp_path / "brought")
    (folder / "metrics.json").write_text(json.dumps({**record(folder), "renderer": BROUGHT}))
    with pytest.raises(InputError, match="expected the pictures that were scored, as a pack keeps them, found none"):
        Rescorer().rescore(folder, small(), tmp_path / "new")
