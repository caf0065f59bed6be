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


def test_mistakes(
    perfect_run: Path, spoiled_run: Path, scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sheet.png"
    assert main([str(tmp_path / "nowhere"), "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "nowhere/metrics.json: no such file" in capsys.readouterr().err
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
    config["config"]["scene"]["content"] = "0" * 64
    (spoiled_run / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match=r"spoiled/config.json: config.scene.content: expected .*, found 00000000"):
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
    with pytest.raises(InputError, match="expected a test view with true albedo and roughness, its light, and a novel light"):
        write_comparison({"perfect": perfect_run}, copy, tmp_path / "sheet.png")
