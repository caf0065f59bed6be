"""A submission to Stanford-ORB: every pair of its list is two files of one view, in the layout of the dataset's own truth."""

import json
from pathlib import Path

import numpy as np
import pytest
from coarse import COARSE

from ia_bench.cli.main import main
from ia_bench.runs import submissions
from ia_bench.scenes.exr import read_exr

CAPTURE = "object_scene001"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run on the scene `tiny`, written as a capture of the dataset."""
    assert main(["export", "tiny", str(tmp_path / "data" / "stanfordorb"), "--format", "stanford_orb"]) == 0
    reader = ["reader=stanford_orb", f"scene.path={tmp_path / 'data' / 'stanfordorb'}", f"reader.options.capture={CAPTURE}"]
    out = tmp_path / "runs" / "ours"
    assert main(["run", *reader, "reader.options.shrink=1", "row=ours", "preset=smoke", "threads=1", *COARSE, f"out={out}"]) == 0
    return out


def test_pairs_are_of_one_view_and_geometry_is_in_the_frame_of_the_camera(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["pack", str(run), "--format", "stanford-orb", "--out", "test/ours"]
    assert main(given) == 2
    assert "expected views of 512 x 512 pixels (reader.options.shrink=4), found 32 x 32" in capsys.readouterr().err
    monkeypatch.setattr(submissions, "SIDE", 32)
    assert main(given) == 0
    found = json.loads(Path("test/ours.json").read_text())["info"][CAPTURE]
    assert set(found) == {"view", "light", "geometry", "material", "shape"}
    pictures = [*found["view"], *found["light"], *found["material"]]
    assert len(found["light"]) > len(found["view"]) >= len(found["geometry"]) > 0
    for pair in (*pictures, *found["geometry"], found["shape"]):
        assert all(Path(path).is_file() for path in pair.values())
    for pair in pictures:
        assert read_exr(Path(pair["output_image"]), 3).shape == (32, 32, 3)
    for kind in ("view", "light"):
        psnr = [
            -10 * np.log10(np.mean((_display(pair["output_image"]) - _display(pair["target_image"])) ** 2)) for pair in found[kind]
        ]
        assert np.mean(psnr) > 12, kind  # another view, or the light of another one, is farther away
    for pair in found["geometry"]:
        normal, true = read_exr(Path(pair["output_normal"]), 3), np.load(pair["target_normal"])
        there = (np.linalg.norm(true, axis=-1) > 0.9) & (np.linalg.norm(normal, axis=-1) > 0.9)
        assert np.median((normal * true).sum(-1)[there]) > 0.98
        depth = read_exr(Path(pair["output_depth"]), 1)[..., 0]
        assert (depth[there] > 0).all()


def _display(path: str) -> np.ndarray:
    return read_exr(Path(path), 3).clip(0, 1) ** (1 / 2.2)
