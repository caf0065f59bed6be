"""Runs beside the truth: a perfect one shows the same pictures, a spoiled one shows where it is wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ia_bench.cli.comparison import main
from ia_bench.common.errors import InputError
from ia_bench.report.comparison import CELL, LEGEND, LINE, LINES, MARGIN, write_comparison
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import read_exr, write_exr


@pytest.fixture
def spoiled_run(perfect_run: Path, tmp_path: Path) -> Path:
    """The same with rougher, greenish paint."""
    folder = shutil.copytree(perfect_run, tmp_path / "spoiled")
    albedo, roughness = read_exr(folder / "albedo.exr", 3), read_exr(folder / "roughness.exr", 1)
    write_exr(folder / "albedo.exr", albedo * np.array([0.5, 1.0, 0.5], np.float32), half=False)
    write_exr(folder / "roughness.exr", np.minimum(roughness + 0.3, 1), half=False)
    return folder


def pictures(sheet: Path, column: int) -> list[np.ndarray]:
    """The pictures of one column, each (CELL, CELL, 3) in [0, 1]."""
    pixels = np.asarray(Image.open(sheet)).astype(float) / 255
    left = LEGEND + column * (CELL + MARGIN)
    tops = [2 * LINE + line * (CELL + LINE + MARGIN) for line in range(len(LINES))]
    return [pixels[top : top + CELL, left : left + CELL] for top in tops]


def test_runs_beside_the_truth(perfect_run: Path, spoiled_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "sheet.png"
    runs = [f"perfect={perfect_run}", str(spoiled_run)]
    assert main([*runs, "--scene", str(scene_folder), "--out", str(out)]) == 0
    photograph, truth, perfect, spoiled = (pictures(out, column) for column in range(4))
    assert all(picture.std() > 0.02 for picture in (photograph[0], *truth))
    assert all((picture == 1).all() for picture in photograph[1:])  # nothing but paper
    for line, noise in enumerate((0.02, 0.02, 0.03)):
        right, wrong = (np.abs(truth[line] - found[line]).mean() for found in (perfect, spoiled))
        assert right < noise
        assert wrong > 1.5 * right
    assert (spoiled[0] - truth[0]).mean((0, 1)).argmax() == 1  # green


def test_a_file_beside_the_runs_that_a_shell_has_named_is_passed_over(
    perfect_run: Path, scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sheet.png").touch()
    out = tmp_path / "out.png"
    assert main([str(perfect_run), str(tmp_path / "sheet.png"), "--scene", str(scene_folder), "--out", str(out)]) == 0
    assert f"{tmp_path / 'sheet.png'}: passed over" in capsys.readouterr().err
    assert Image.open(out).width == LEGEND + 3 * (CELL + MARGIN) + MARGIN
    assert main([str(tmp_path / "sheet.png"), "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "sheet.png: expected a folder with runs, found none" in capsys.readouterr().err


def test_each_run_is_drawn_on_the_mesh_that_it_had(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    blurred = shutil.copytree(perfect_run, tmp_path / "blurred")
    config = json.loads((blurred / "config.json").read_text())
    config["config"]["capture"] = {"geometry": "smoothed", "smoothing": 0.05}
    (blurred / "config.json").write_text(json.dumps(config))
    sheets, a, b = [], {"a": perfect_run}, {"b": blurred}
    for number, runs in enumerate((a, b, a | b, b | a)):
        write_comparison(runs, scene_folder, tmp_path / f"{number}.png")
        sheets.append({name: np.stack(pictures(tmp_path / f"{number}.png", 2 + column)) for column, name in enumerate(runs)})
    sharp, smooth = sheets[0]["a"], sheets[1]["b"]
    assert np.abs(sharp - smooth).mean() > 0.01
    for both in sheets[2:]:
        np.testing.assert_array_equal(both["a"], sharp)
        np.testing.assert_array_equal(both["b"], smooth)


def test_a_run_without_a_light_has_no_picture_of_it(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    (perfect_run / "light.exr").unlink()
    write_comparison({"run": perfect_run}, scene_folder, tmp_path / "sheet.png")
    pixels = np.asarray(Image.open(tmp_path / "sheet.png"))
    left = [LEGEND + column * (CELL + MARGIN) for column in range(3)]
    lights = [pixels[-CELL // 2 - MARGIN : -MARGIN, start : start + CELL] for start in left]
    assert [bool((light == 255).all()) for light in lights] == [True, False, True]


def test_scale_of_the_run_is_applied(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    metrics = json.loads((perfect_run / "metrics.json").read_text())
    metrics["albedo_scales"]["mean_rgb"] = None  # undefined: shown as it is
    (perfect_run / "metrics.json").write_text(json.dumps(metrics))
    write_comparison({"run": perfect_run}, scene_folder, tmp_path / "sheet.png")
    truth, found = (pictures(tmp_path / "sheet.png", column)[0] for column in (1, 2))
    assert (truth - found).mean() > 0.01


def test_the_scale_of_a_run_is_that_of_the_textures_in_its_folder(perfect_run: Path) -> None:
    """A method with a renderer of its own has maps beside them, which may be brighter or darker."""
    metrics = json.loads((perfect_run / "metrics.json").read_text())
    metrics["albedo_scales"] = {"mean_rgb": [3.0] * 3, "mean_rgb_reference": [1.5] * 3}
    (perfect_run / "metrics.json").write_text(json.dumps(metrics))
    assert Recovered(perfect_run).scale.tolist() == [1.5] * 3


def test_mistakes(
    perfect_run: Path, spoiled_run: Path, scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sheet.png"
    assert main([str(tmp_path / "nowhere"), "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "nowhere: expected a folder with runs, found none" in capsys.readouterr().err
    assert main([str(perfect_run), f"{perfect_run.name}={spoiled_run}", "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "expected different names of the runs, found run, run" in capsys.readouterr().err
    for name in ("truth", "photograph"):
        with pytest.raises(InputError, match=f"expected another name than {name}"):
            write_comparison({name: perfect_run}, scene_folder, out)
    with pytest.raises(InputError, match="expected at least one run"):
        write_comparison({}, scene_folder, out)
    config = json.loads((spoiled_run / "config.json").read_text())
    config["config"]["reader"]["options"]["uv"] = "xatlas"
    (spoiled_run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match=r"the same reader, found .*xatlas"):
        write_comparison({"a": perfect_run, "b": spoiled_run}, scene_folder, out)
    config["identity"]["scene"]["content"] = "0" * 64
    (spoiled_run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match=r"spoiled/config.json: expected the files of the run's scene"):
        write_comparison({"a": perfect_run, "b": spoiled_run}, scene_folder, out)
    assert not out.exists()


def test_scene_without_novel_lights(
    perfect_run: Path, scene_folder: Path, put_on_scene: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    copy = shutil.copytree(scene_folder, tmp_path / "scene")
    novel = json.loads((copy / "transforms_novel.json").read_text())
    novel["frames"] = [frame for frame in novel["frames"] if frame.get("light", "train") == "train"]
    (copy / "transforms_novel.json").write_text(json.dumps(novel))
    put_on_scene(perfect_run, copy)
    write_comparison({"perfect": perfect_run}, copy, tmp_path / "sheet.png")
    photograph, truth, perfect = (pictures(tmp_path / "sheet.png", column) for column in range(3))
    assert (truth[0] == 1).all()  # what a run renders is beside the photograph
    assert np.abs(photograph[0] - perfect[0]).mean() < 0.03
    for line in (1, 2):
        assert np.abs(truth[line] - perfect[line]).mean() < 0.02  # aligned albedo, roughness


def test_results_that_are_missing(
    perfect_run: Path, scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sheet.png"
    (perfect_run / "roughness.exr").unlink()
    assert main([str(perfect_run), "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "roughness.exr: no such image" in capsys.readouterr().err
    record = json.loads((perfect_run / "metrics.json").read_text())
    (perfect_run / "metrics.json").write_text(json.dumps({**record, "status": "failed", "error": "boom"}))
    with pytest.raises(InputError, match="expected a finished run, found status 'failed'"):
        write_comparison({"run": perfect_run}, scene_folder, out)
    assert not out.exists()


def test_columns_stand_as_they_are_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr("ia_bench.report.comparison.write_comparison", lambda runs, scene, out: drawn.extend(runs))
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
    (tmp_path / "sheet.png").touch()
    runs = [str(tmp_path / "b"), f"named={tmp_path / 'a'}", str(tmp_path / "sheet.png"), str(tmp_path / "a")]
    assert main([*runs, "--scene", str(tmp_path), "--out", str(tmp_path / "out.png")]) == 0
    assert drawn == ["b", "named", "a"]


def test_run_of_another_scene_is_refused(
    perfect_run: Path, scene_folder: Path, tiny_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also one whose mesh has as many vertices, in a folder of the same name."""
    out = tmp_path / "sheet.png"
    write_comparison({"run": perfect_run}, tiny_copy, out)  # the same scene in another place
    out.unlink()
    (tiny_copy / "scene.json").write_text((scene_folder / "scene.json").read_text() + "\n")
    assert main([str(perfect_run), "--scene", str(tiny_copy), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert f"{perfect_run / 'config.json'}: expected the files of the run's scene, tiny, found other ones in {tiny_copy}" in message
    with pytest.raises(InputError, match="nowhere: no such folder"):
        write_comparison({"run": perfect_run}, tmp_path / "nowhere", out)
    assert not out.exists()


def test_scene_without_truth(
    perfect_run: Path, scene_folder: Path, put_on_scene: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    copy = shutil.copytree(scene_folder, tmp_path / "scene", ignore=shutil.ignore_patterns("transforms_[!t]*", "transforms_test*"))
    description = json.loads((scene_folder / "scene.json").read_text())
    kept = {key: value for key, value in description.items() if key not in ("truth_textures", "lights", "splits")}
    (copy / "scene.json").write_text(json.dumps(kept))
    train = json.loads((scene_folder / "transforms_train.json").read_text())
    for frame in train["frames"]:
        frame.pop("albedo_path"), frame.pop("specular_path")
    (copy / "transforms_train.json").write_text(json.dumps(train))
    put_on_scene(perfect_run, copy)
    write_comparison({"run": perfect_run}, copy, tmp_path / "sheet.png")
    photograph, run = (pictures(tmp_path / "sheet.png", column) for column in range(2))
    width = Image.open(tmp_path / "sheet.png").width
    assert width == LEGEND + 2 * (CELL + MARGIN) + MARGIN  # no column for a truth that nobody knows
    assert np.abs(photograph[0] - run[0]).mean() < 0.03  # the perfect run's render of a photograph
    assert all(picture.std() > 0.02 for picture in run)
