"""The contact sheet of a run that recovered the truth shows the same picture twice; what is missing is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ia_bench.cli.pictures import main
from ia_bench.common.errors import InputError
from ia_bench.report.pictures import CELL, COLUMNS, LINE, MARGIN, write_contact_sheet


def cells(sheet: Path, row: int) -> list[np.ndarray]:
    """The pictures of one row, each (CELL, CELL, 3) in [0, 1]."""
    pixels = np.asarray(Image.open(sheet)).astype(float) / 255
    top = 2 * LINE + row * (CELL + MARGIN)
    return [pixels[top : top + CELL, MARGIN + c * (CELL + MARGIN) :][:, :CELL] for c in range(len(COLUMNS))]


def test_perfect_run_shows_the_truth_twice(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "sheet.png"
    assert main([str(perfect_run), "--scene", str(scene_folder), "--out", str(out), "--views", "2"]) == 0
    for row in range(2):
        photograph, render, albedo, found_albedo, roughness, found_roughness = cells(out, row)
        assert all(picture.std() > 0.02 for picture in (photograph, render, albedo, roughness))
        assert np.abs(albedo - found_albedo).mean() < 0.02
        assert np.abs(roughness - found_roughness).mean() < 0.02
        assert np.abs(photograph - render).mean() < 0.03  # noise, and light by way of a mirror
        assert np.abs(photograph - albedo).mean() > 0.02
        assert photograph[0, 0].tolist() == [128 / 255] * 3  # grey
    assert not np.array_equal(cells(out, 0)[0], cells(out, 1)[0])
    pixels = np.asarray(Image.open(out)).astype(float)
    top, width = 2 * LINE + 2 * (CELL + MARGIN) + LINE, (pixels.shape[1] - 3 * MARGIN) // 2
    true, found = (pixels[top : top + width // 2, left : left + width] for left in (MARGIN, 2 * MARGIN + width))
    assert true.std() > 10
    assert np.abs(true - found).max() <= 1  # of 255


def test_scale_of_the_run_is_applied(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    metrics = json.loads((perfect_run / "metrics.json").read_text())
    metrics["albedo_scales"]["mean_rgb"] = None  # undefined: shown as it is
    (perfect_run / "metrics.json").write_text(json.dumps(metrics))
    write_contact_sheet(perfect_run, scene_folder, tmp_path / "sheet.png", views=1)
    _, _, albedo, found, *_ = cells(tmp_path / "sheet.png", 0)
    assert (albedo - found).mean() > 0.01


def test_mistakes(perfect_run: Path, scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sheet.png"
    with pytest.raises(InputError, match="nowhere/metrics.json: no such file"):
        write_contact_sheet(tmp_path / "nowhere", scene_folder, out)
    with pytest.raises(InputError, match="at least one view, found 0"):
        write_contact_sheet(perfect_run, scene_folder, out, views=0)
    (perfect_run / "roughness.exr").unlink()
    assert main([str(perfect_run), "--scene", str(scene_folder), "--out", str(out)]) == 2
    assert "roughness.exr: no such image" in capsys.readouterr().err
    (perfect_run / "metrics.json").write_text('{"status": "failed"}')
    with pytest.raises(InputError, match="expected a finished run, found status 'failed'"):
        write_contact_sheet(perfect_run, scene_folder, out)
    assert not out.exists()


def without(path: Path, key: str) -> None:
    """Remove a dotted key from a JSON file."""
    content = json.loads(path.read_text())
    *above, last = key.split(".")
    inside = content
    for part in above:
        inside = inside[part]
    del inside[last]
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("file", "key"),
    [
        ("metrics.json", "status"),
        ("metrics.json", "protocol_description"),
        ("metrics.json", "albedo_scales"),
        ("metrics.json", "metrics.relighting"),
        ("metrics.json", "row"),
        ("config.json", "config.scene.content"),
        ("config.json", "config.render"),
        ("config.json", "config.reader.name"),
    ],
)
def test_missing_keys_are_named(perfect_run: Path, scene_folder: Path, tmp_path: Path, file: str, key: str) -> None:
    without(perfect_run / file, key)
    with pytest.raises(InputError, match=rf"{file}: {key}(\.\w+)?: expected [\w |]+, found nothing$"):
        write_contact_sheet(perfect_run, scene_folder, tmp_path / "sheet.png")


def test_values_of_another_kind_are_named(perfect_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    metrics = json.loads((perfect_run / "metrics.json").read_text())
    metrics["metrics"]["relighting"]["psnr"] = "much"
    (perfect_run / "metrics.json").write_text(json.dumps(metrics))
    with pytest.raises(InputError, match=r"metrics.relighting.psnr: expected float \| int \| None, found 'much'"):
        write_contact_sheet(perfect_run, scene_folder, tmp_path / "sheet.png")
    (perfect_run / "metrics.json").write_text("[]")
    with pytest.raises(InputError, match="metrics.json: expected a JSON object, found list"):
        write_contact_sheet(perfect_run, scene_folder, tmp_path / "sheet.png")


def test_run_of_another_scene_is_refused(
    perfect_run: Path, scene_folder: Path, tiny_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also one whose mesh has as many vertices, in a folder of the same name."""
    out = tmp_path / "sheet.png"
    write_contact_sheet(perfect_run, tiny_copy, out, views=1)  # the same scene in another place
    out.unlink()
    (tiny_copy / "scene.json").write_text((scene_folder / "scene.json").read_text() + "\n")
    assert main([str(perfect_run), "--scene", str(tiny_copy), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert f"{perfect_run / 'config.json'}: config.scene.content: expected " in message
    assert f"the content of {tiny_copy}, found" in message
    assert "another scene (tiny)" in message
    with pytest.raises(InputError, match="nowhere: no such folder"):
        write_contact_sheet(perfect_run, tmp_path / "nowhere", out)
    assert not out.exists()


def test_scene_without_truth(
    perfect_run: Path, scene_folder: Path, put_on_scene: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    copy = shutil.copytree(scene_folder, tmp_path / "scene", ignore=shutil.ignore_patterns("transforms_[!t]*", "transforms_test*"))
    description = json.loads((scene_folder / "scene.json").read_text())
    kept = {key: value for key, value in description.items() if key not in ("truth_textures", "splits")}
    (copy / "scene.json").write_text(json.dumps(kept))
    train = json.loads((scene_folder / "transforms_train.json").read_text())
    for frame in train["frames"]:
        frame.pop("albedo_path"), frame.pop("specular_path")
    (copy / "transforms_train.json").write_text(json.dumps(train))
    put_on_scene(perfect_run, copy)
    with pytest.raises(InputError, match="expected test views with true albedo and roughness"):
        write_contact_sheet(perfect_run, copy, tmp_path / "sheet.png")
