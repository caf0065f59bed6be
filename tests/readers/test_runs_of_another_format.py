"""A run of another format's files is read back from its folder, with the maps and the mesh that lie elsewhere."""

from pathlib import Path

import pytest
from layouts import scene_to_write

from ia_bench.readers.writers.frames import write_nerfactor
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
