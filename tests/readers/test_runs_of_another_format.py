"""A run of another format's files is read back from its folder, with the maps and the mesh that lie elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from layouts import scene_to_write

from ia_bench.readers.pictures import maps_below
from ia_bench.readers.writers.frames import write_nerfactor
from ia_bench.readers.writers.parts import save_exr
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.identity import hash_of, identity, setup
from ia_bench.runs.record import RunRecord
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Scene

SCORES = {"albedo": {"psnr": 20.0}}
RECORD = RunRecord(row="none", scene="tiny", seed=0, protocol="none", config_hash="", status="ok", metrics=SCORES)


def test_it_is_read_from_where_the_run_did(tmp_path: Path, tiny: Scene, tiny_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run on tiny in NeRFactor's layout, which named its files from the folder that it was started in."""
    write_nerfactor(tmp_path / "theirs" / "tiny", scene_to_write(tiny))
    monkeypatch.chdir(tmp_path / "theirs")
    (tmp_path / "theirs" / "mesh.ply").write_bytes((tiny_folder / "mesh.ply").read_bytes())
    files = ["scene.path=tiny", "reader.options.lights=tiny/lights", "reader.options.mesh=mesh.ply"]
    config = compose(["reader=nerfactor", *files, "prior=none", "device=cpu", "capture=phone"])
    content = identity(config)
    with RunFolder(tmp_path / "run", content, hash_of(content), setup=setup(config)) as folder:
        folder.write_record(RECORD)
    monkeypatch.chdir(tmp_path)
    run = Recovered(tmp_path / "run")
    scene = run.read_scene(whole=True)
    assert "train" in scene.truth.lights
    assert len(scene.expect_mesh().vertices) > 0
    assert run.config.capture.label == "phone"


def test_a_novel_light_may_be_called_as_the_training_one(tmp_path: Path, tiny: Scene) -> None:
    """NeRFactor multiplies a light by a strength for training alone: held-out photographs under it have the map as it is."""
    lit = replace(tiny.novel[0], light="studio")
    save_exr(tmp_path / "studio.exr", np.ones((4, 8, 3), np.float32))
    notes = list[str]()
    found = maps_below(str(tmp_path), [lit, replace(lit, light="city")], notes, "studio", 3.0).lights
    assert {name: float(light.mean()) for name, light in found.items()} == {"train": 3.0, "studio": 1.0}
    assert notes == [f"no environment map of city in {tmp_path}"]
