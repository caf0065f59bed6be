"""The front door for Python gives what the command gives: the same run in the same folder, and the same numbers read back."""

import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import ia_bench as ib
from ia_bench.cli.run import main
from ia_bench.readers.writers.frames import write_blender
from ia_bench.scenes.exr import write_exr

SETTINGS = {"preset": "smoke", "device": "cpu", "threads": 1, "fit": {"stage1_steps": 2, "stage2_steps": 1}}


@pytest.fixture(scope="module")
def scene() -> ib.LoadedScene:
    return ib.load("tiny")


@pytest.fixture(scope="module")
def fit(scene: ib.LoadedScene, tmp_path_factory: pytest.TempPathFactory) -> ib.Fit:
    return ib.fit(scene, out=tmp_path_factory.mktemp("runs") / "fit", progress=False, **SETTINGS)


def test_a_fit_read_back_scores_the_same(
    fit: ib.Fit, scene: ib.LoadedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.set_num_threads(1)
    assert ib.score(fit, scene) == fit.metrics
    assert ib.score(fit, protocol="tensoir") != fit.metrics
    assert fit.metallic is None
    monkeypatch.chdir(fit.folder.parent)
    found = ib.Fit("fit")
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(found.albedo, fit.albedo)


def test_a_light_is_a_name_a_file_or_an_array(fit: ib.Fit, scene: ib.LoadedScene, tmp_path: Path) -> None:
    camera, name = scene.test[0].camera, next(iter(scene.truth.lights))
    write_exr(tmp_path / "light.exr", scene.truth.lights[name], half=False)
    named, read, given = (fit.render(camera, light) for light in (name, tmp_path / "light.exr", scene.truth.lights[name]))
    assert named.shape == (camera.height, camera.width, 3)
    np.testing.assert_array_equal(named, read)
    np.testing.assert_array_equal(named, given)
    np.testing.assert_array_equal(fit.render(camera), fit.render(camera, fit.light))
    np.testing.assert_allclose(fit.render(camera, 2 * fit.light), 2 * fit.render(camera), rtol=1e-5)
    relit = fit.relight(name, f"test/{scene.test[0].name}", size=16, samples=8)
    assert (relit.mode, relit.size) == ("RGBA", (16, 16))
    with pytest.raises(ib.InputError, match="unknown light 'dusk'. There are: train, studio, sunset, night; or the file of a map"):
        fit.render(camera, "dusk")
    for wrong, said in (
        (np.ones((16, 16, 3)), r"\(H, 2 H, 3\)"),
        (-np.ones((4, 8, 3)), "-1 to -1"),
        (np.full((4, 8, 3), np.nan), "nan"),
        (np.full((4, 8, 3), 1e300), "finite radiance of 0 and more, found inf to inf"),
        (np.ones((4, 8, 3), object), "object"),
    ):
        with pytest.raises(ib.InputError, match=said):
            fit.render(camera, wrong)
    for call, named in ((fit.render, {"samples": 0}), (fit.relight, {"samples": -1}), (fit.relight, {"size": 0})):
        with pytest.raises(ib.InputError, match=f"{[*named][0]}: expected a whole number of at least 1, found"):
            call(camera if call == fit.render else name, **named)


def test_the_asset_is_a_glb(fit: ib.Fit, tmp_path: Path) -> None:
    assert fit.save(tmp_path / "new" / "asset.glb").read_bytes() == (fit.folder / "asset.glb").read_bytes()
    assert fit.save(fit.folder / "asset.glb").read_bytes() == (tmp_path / "new" / "asset.glb").read_bytes(), "onto itself"
    with pytest.raises(ib.InputError, match="expected a name that ends with .glb, found .obj"):
        fit.save(tmp_path / "asset.obj")


def test_a_table_has_a_line_per_run(fit: ib.Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = ib.table([fit])
    assert shown.loc[0, "aligned_albedo_psnr"] == fit.metrics["aligned_albedo"]["psnr"]
    assert "problem" not in shown
    assert ib.table([fit.folder.parent]).equals(shown)
    monkeypatch.chdir(fit.folder.parent)
    assert ib.table([fit, ".", f"../{fit.folder.parent.name}"]).equals(shown), "a run is there once, whatever its folder is called"


def test_a_record_that_is_torn_is_named(fit: ib.Fit, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "metrics.json").write_text('{"row":')
    assert len(ib.table([fit, tmp_path])) == 1
    assert f"left out, no record of a run: {tmp_path / 'torn' / 'metrics.json'}" in caplog.text


def test_notes_are_logged_and_nothing_is_printed_and_the_command_finds_the_fit(
    fit: ib.Fit, scene: ib.LoadedScene, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.INFO, "ia_bench"):
        ib.fit(scene, out=fit.folder, progress=False, **SETTINGS)
    assert "already finished" in caplog.text
    assert capsys.readouterr() == ("", "")
    words = ["scene=tiny", "preset=smoke", "threads=1", "device=cpu", "fit.stage1_steps=2", "fit.stage2_steps=1"]
    assert main([*words, f"out={fit.folder}"]) == 0
    told = capsys.readouterr()
    assert "already finished" in told.err
    assert told.out.startswith(f"{fit!r}\n")


def test_a_changed_scene_is_refused(scene: ib.LoadedScene) -> None:
    for wrong in (replace(scene, train=scene.train[:4]), "tiny"):
        with pytest.raises(ib.InputError, match=r"scene: expected what ib.load has read from files, found (one|str)"):
            ib.fit(wrong)


def test_a_folder_is_no_name(scene: ib.LoadedScene, tiny_copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tiny_copy.parent)
    assert ib.load("./tiny").settings == (f"scene.path='{tiny_copy.resolve()}'", "reader='native'")
    write_blender(Path("theirs"), scene)
    given = {"reader.options.mesh": Path("tiny/mesh.ply")}
    assert ib.load("theirs", reader="nerfstudio", **given).settings[-1] == f"reader.options.mesh='{tiny_copy / 'mesh.ply'}'"
    with pytest.raises(ib.InputError, match="did you mean 'tiny'"):
        ib.load("tinny")


NO_PATHS = {
    "nothing": None,
    "a number": 3,
    "NaN": np.nan,
    "a list": [],
    "bytes": b"x",
    "no text": "",
    "NUL": "a\0b",
    "long": "x" * 5000,
}


@pytest.mark.parametrize("wrong", NO_PATHS.values(), ids=NO_PATHS)
def test_what_is_no_path_is_told_in_a_sentence(fit: ib.Fit, scene: ib.LoadedScene, wrong: Any) -> None:
    for name, call in {
        "scene": lambda: ib.load(wrong, reader="dtu"),
        "folder": lambda: ib.Fit(wrong),
        "path": lambda: fit.save(wrong),
        "runs": lambda: ib.table([wrong]),
        "image": lambda: ib.decompose(wrong),
        **({"out": lambda: ib.fit(scene, out=wrong)} if wrong is not None else {}),
    }.items():
        with pytest.raises(ib.InputError, match=f"^{name}: expected a path, found "):
            call()


def test_an_argument_of_another_kind_is_told_in_a_sentence(fit: ib.Fit, scene: ib.LoadedScene) -> None:
    camera, light = scene.test[0].camera, next(iter(scene.truth.lights))
    blind = replace(camera, to_world=np.full((4, 4), np.nan))
    for call, said in (
        (lambda: ib.load("~nobody_of_that_name/mug"), "scene=~nobody_of_that_name/mug: expected a path, found one without a home"),
        (lambda: ib.load("tiny", reader=np.ones(3)), "reader: expected a reader's name, found ndarray"),
        (lambda: ib.load("tiny", reader="x" * 5000), "reader: expected one name, found 'xxx"),
        (lambda: ib.load(".", reader="dtu", **{"reader.options.every": 1}), "reader.options.every: expected 2 or more, found 1"),
        (lambda: fit.render("test/0001"), "camera: expected a Camera, found str"),
        (lambda: fit.render(blind), "camera: expected a rotation and a translation"),
        (lambda: fit.render(camera, samples=np.nan), "samples: expected a whole number of at least 1, found nan"),
        (lambda: fit.relight(light, None), "view: expected text, found NoneType"),
        (lambda: fit.relight(light, background="trasparent"), "unknown background 'trasparent'; did you mean 'transparent'"),
        (lambda: ib.score(fit.folder), "found: expected a Fit, found PosixPath"),
        (lambda: ib.score(fit, "tiny"), "scene: expected a scene, found str"),
        (lambda: ib.score(fit, protocol=3), "protocol: expected a protocol's name, found int"),
        (lambda: ib.table(fit), "runs: expected a list of fits and folders, found Fit"),
        (lambda: ib.table("runs"), "runs: expected a list of fits and folders, found str"),
        (lambda: ib.decompose("a.png", prior=None), "prior: expected a prior's name, found NoneType"),
        (lambda: ib.decompose("a.png", options=[]), "options: expected a table, found list"),
        (lambda: ib.decompose("a.png", size=7), "size: expected a whole number of at least 8, found 7"),
    ):
        with pytest.raises(ib.InputError, match=f"^{said}"):
            call()


def test_values_are_written_as_hydra_reads_them(scene: ib.LoadedScene) -> None:
    with pytest.raises(ib.InputError, match=r"capture\.views: 'it's a, \[b\]'\. There are: all"):
        ib.fit(scene, row="it's a, [b]", capture={"views": "it's a, [b]"})
    with pytest.raises(ib.InputError, match=r"seed: expected 0 or more, found -1"):
        ib.fit(scene, seed=np.int64(-1), capture={"percentile": np.float32(80)})
    with pytest.raises(ib.InputError, match=r"capture\.views: expected a number, a text, a list or a table, found ndarray"):
        ib.fit(scene, capture={"views": np.arange(2)})


def test_importing_takes_no_package_and_names_are_there() -> None:
    code = (
        "import sys; before = set(sys.modules); import ia_bench as ib; print(*set(sys.modules) - before); print(*dir(ib));"
        "print(hasattr(ib, 'nothing'))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert not {"torch", "numpy", "pandas", "hydra"} & set(told[0].split())
    assert set(ib.__all__) <= set(told[1].split())
    assert told[2:] == ["False"]
