"""``ia-bench score``: a run's own asset and pictures come back with the run's scores, as rows that say what is declared."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from coarse import COARSE

from ia_bench.cli.score import main
from ia_bench.render.asset_files import moved, read_asset
from ia_bench.report.blocks import block
from ia_bench.report.collect import collect
from ia_bench.report.table import results_table
from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.runs.recovered import Rescorer

SMALL = ["protocol=paper-v2", *COARSE, "device=cpu", "threads=1"]


def metrics(folder: Path) -> dict[str, dict[str, float]]:
    return json.loads((folder / "metrics.json").read_text())["metrics"]


def differences(folder: Path, other: Path) -> dict[str, float]:
    """The largest difference of each metric, over components."""
    found: dict[str, float] = {}
    for component, values in metrics(folder).items():
        for name, value in values.items():
            if "light" not in component:  # which is not seen in pictures
                found[name] = max(found.get(name, 0.0), abs(value - metrics(other)[component][name]))
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short fit of tiny."""
    folder = tmp_path_factory.mktemp("runs") / "none"
    execute(compose(["scene=tiny", "preset=smoke", *SMALL, f"out={folder}"]))
    return folder


@pytest.fixture(scope="module")
def asset_run(run: Path) -> Path:
    out = run.parent / "asset"
    declared = ["--seconds", "3.5", "--authors", "Ada, Bo", "--code=their own", "--row", "theirs"]
    files = [str(run / "asset.glb"), "--light", str(run / "light.exr")]
    assert main([*files, "--scene", "tiny", "--out", str(out), *declared, *SMALL]) == 0
    return out


@pytest.fixture(scope="module")
def pictures_run(run: Path) -> Path:
    assert main([str(run), "--pictures", str(run.parent / "pictures")]) == 0
    out = run.parent / "images"
    assert main([str(run.parent / "pictures"), "--scene", "tiny", "--out", str(out), *SMALL]) == 0
    return out


def test_an_asset_and_pictures_brought_back_have_the_scores_of_their_run(run: Path, asset_run: Path, pictures_run: Path) -> None:
    found = differences(run, asset_run)
    assert (found["psnr"] < 0.02, found["mse"] < 0.0002, found["ssim"] < 1e-3) == (True, True, True), found
    assert max(differences(run, pictures_run).values()) < 1e-6


def test_an_asset_is_rescored_on_its_own_mesh(run: Path, tmp_path: Path) -> None:
    asset = read_asset(run / "asset.glb", note=print)
    larger = moved(asset, np.diag([1.03, 1.03, 1.03, 1]))
    solid = trimesh.Trimesh(larger.mesh.vertices, larger.mesh.faces)
    (tmp_path / "larger.obj").write_text(f"mtllib m.mtl\n{solid.export(file_type='obj')}")
    (tmp_path / "m.mtl").write_text("newmtl one\nKd .5 .4 .3\n")
    options = ["--up", "z", "--light", str(run / "light.exr"), "--scene", "tiny", "--out", str(tmp_path / "run")]
    assert main([str(tmp_path / "larger.obj"), *options, *SMALL]) == 0
    before = json.loads((tmp_path / "run" / "metrics.json").read_text())
    again = Rescorer().rescore(tmp_path / "run", compose(["scene=tiny", *SMALL]).protocol, tmp_path)
    after = json.loads((again / "metrics.json").read_text())
    assert before["metrics"]["roughness"]["mse"] is after["metrics"]["roughness"]["mse"] is None
    assert before["geometry"]["chamfer"] > 0.002
    for group, name in (("metrics", "view_synthesis"), ("metrics", "albedo"), ("geometry", "")):
        found, expected = ((record[group].get(name) or record[group]) for record in (after, before))
        for key in ("psnr", "chamfer", "depth", "mask_iou"):
            assert found.get(key, 0) == pytest.approx(expected.get(key, 0), abs=2e-3)


def test_what_is_declared_is_marked_as_declared(asset_run: Path, pictures_run: Path) -> None:
    record = json.loads((asset_run / "metrics.json").read_text())
    assert record["declared"] == {"authors": "Ada, Bo", "code": "their own", "hardware": "", "seconds": 3.5}
    runs = collect([asset_run, pictures_run]).runs
    assert runs["declared"].tolist() == ["yes", "yes"]
    assert runs["declared_authors"].tolist() == ["Ada, Bo", None]
    printed = results_table(block(runs, ["theirs", "images"], ["tiny"], "tiny"), dict.fromkeys(["no reason given"], 1), made={})
    assert [row[-3] for row in printed.body] == ["3.5 (declared)", "–"]
