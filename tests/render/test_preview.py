"""Preview pictures of a glTF asset: upright, from all sides; a missing library is one clear sentence."""

from __future__ import annotations

import ctypes.util
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ia_bench.cli.preview import main
from ia_bench.common.errors import InputError
from ia_bench.render.preview import render_preview
from ia_bench.runs.assets import glb
from ia_bench.scenes.scene import Mesh

needs_opengl = pytest.mark.skipif(
    importlib.util.find_spec("pyrender") is None or ctypes.util.find_library("OSMesa") is None,
    reason="preview pictures need pyrender and OSMesa (extra 'preview')",
)


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """A run's folder with a tower: four walls, red in the lower half and green above; the wall toward -y is darker."""
    quads, normals, uvs = [], [], []
    for number, (x, y) in enumerate([(0, -1), (1, 0), (0, 1), (-1, 0)]):
        outward, along = np.array([x, y, 0.0]), np.array([-y, x, 0.0])
        corners = [outward - along, outward + along, outward + along, outward - along]
        quads += [corner + [0, 0, z] for corner, z in zip(corners, (-2, -2, 2, 2), strict=True)]
        normals += 4 * [outward]
        left = 0.02 if number == 0 else 0.52
        uvs += [(left, 0.02), (left + 0.46, 0.02), (left + 0.46, 0.98), (left, 0.98)]
    faces = [[4 * n + i for i in triangle] for n in range(4) for triangle in ((0, 1, 2), (0, 2, 3))]
    vertices, normal, uv = (np.array(values, np.float32) for values in (quads, normals, uvs))
    mesh = Mesh(vertices, np.array(faces, np.int32), normal, uv)
    albedo = np.zeros((32, 32, 3))
    albedo[:16], albedo[16:] = (0.0, 0.5, 0.0), (0.5, 0.0, 0.0)  # row 0 is v = 1
    albedo[:, :16] *= 0.2
    (tmp_path / "asset.glb").write_bytes(glb(mesh, albedo, np.full((32, 32), 0.9)))
    return tmp_path


@needs_opengl
def test_pictures_are_upright_and_go_around(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(run_folder), "--views", "4", "--size", "96"]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [path.name for path in written] == [f"preview_{angle:03d}.png" for angle in (0, 90, 180, 270)]
    pictures = [np.asarray(Image.open(path)).astype(float) for path in written]
    for picture in pictures:
        assert picture.shape == (96, 96, 4)
        assert picture[0, 0, 3] == 0
        assert picture[48, 48, 3] == 255
        upper, lower = picture[30, 48], picture[66, 48]
        assert upper[1] > 2 * upper[0]
        assert lower[0] > 2 * lower[1]
    brightness = [picture[66, 48, 0] for picture in pictures]
    assert brightness[0] < 0.7 * min(brightness[1:])  # glTF's +z, where the orbit starts, is our -y


@needs_opengl
def test_same_pictures_again(run_folder: Path) -> None:
    first, second = (render_preview(run_folder / "asset.glb", run_folder / n, views=1, size=40)[0] for n in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_missing_library_says_how_to_get_it(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrender", None)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "osmesa")
    with pytest.raises(InputError, match=r"preview pictures cannot be drawn \(.*: .*pyrender==0\.1\.45.*libosmesa6"):
        render_preview(run_folder / "asset.glb", run_folder)
    assert list(run_folder.glob("*.png")) == []


def test_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error == f"ia_bench: {tmp_path}/asset.glb: no such file; a finished run leaves it\n"
    (tmp_path / "asset.glb").write_bytes(b"glTF but not really")
    assert main([str(tmp_path)]) == 2
    assert "asset.glb: not a readable glTF file" in capsys.readouterr().err
    assert main([str(tmp_path), "--views", "0"]) == 2
    assert "at least one view" in capsys.readouterr().err
