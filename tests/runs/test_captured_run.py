"""A whole run of what a phone would give: few views, eight bits, exposures that nobody knows, no mesh in the folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ia_bench.common.errors import InputError
from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.runs.recovered import Rescorer

SMALL = ["protocol.map_points=2", "protocol.render_points=2", "protocol.samples_per_pixel=8"]
PHONE = ["capture.views=12", "capture.radiometry=ldr", "capture.exposure=per_image", "capture.geometry=hull"]
COARSE = ["capture.cells=48", "capture.triangles=2000"]


@pytest.mark.slow
def test_masks_and_images_alone_give_a_whole_run(tiny_copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))
    (tiny_copy / "mesh.ply").unlink()
    folder = tmp_path / "run"
    words = [f"scene.path={tiny_copy}", "preset=smoke", "threads=1", f"out={folder}", *SMALL, *PHONE, *COARSE]
    execute(compose(words))
    found = json.loads((folder / "metrics.json").read_text())
    assert found["capture"]["views"] == 12
    assert (found["capture"]["exposure"], found["capture"]["geometry"]) == ("per_image", "hull")
    assert 0 < found["capture"]["saturated_share"] < 0.1
    assert found["geometry"]["mask_iou"] > 0.9
    assert found["geometry"]["missed_share"] < 0.02
    assert found["geometry"]["reasons"]["normals_degrees"] == "the scene has no true mesh"
    assert found["metrics"]["view_synthesis"]["psnr"] > 13
    assert (folder / "asset.glb").is_file()
    # scored again, on the mesh that is made again from the same masks
    again = Rescorer(compose(["scene=tiny", *SMALL]).protocol, tmp_path / "again", tiny_copy).rescore(folder)
    scored = json.loads((again / "metrics.json").read_text())
    assert (scored["metrics"], scored["geometry"]) == (found["metrics"], found["geometry"])


def test_a_run_that_needs_the_mesh_says_what_to_set(tiny_copy: Path, tmp_path: Path) -> None:
    (tiny_copy / "mesh.ply").unlink()
    with pytest.raises(InputError, match="capture.geometry=given: expected a mesh.*capture.geometry=hull makes one"):
        execute(compose([f"scene.path={tiny_copy}", f"out={tmp_path / 'run'}", "threads=1"]))
