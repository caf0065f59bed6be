"""Pictures under one's own light through the command line: what files hold, which way light and object turn, and bad input."""

import math
import shutil
import stat
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

from ia_bench.cli.main import main
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.runs.relighting import RelitView, _around, _behind, _turned, frames_of
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene
from tests.shapes import sphere

QUICK = ["--size", "48", "--samples", "18", "--threads", "1"]


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map that is bright on one side."""
    path = tmp_path_factory.mktemp("lights") / "side.exr"
    write_exr(path, side())
    return path


def side() -> np.ndarray:
    """A map (16, 32, 3) of different columns."""
    columns = np.linspace(0.1, 2.0, 32, dtype=np.float32)
    return np.broadcast_to(columns[None, :, None] * np.array([1.0, 0.5, 0.25], np.float32), (16, 32, 3)).copy()


def relit(what: Path, light: Path | list[Path], out: Path, *more: str) -> int:
    lights = [light] if isinstance(light, Path) else light
    return main(["relight", str(what), "--light", *map(str, lights), "--out", str(out), *QUICK, *more])


def test_a_turned_light_is_seen_where_it_falls_from() -> None:
    camera = _around(sphere(), 0.3, 24)
    turned = _behind(RelitView(camera), _turned(side(), math.pi / 4))
    np.testing.assert_allclose(_behind(RelitView(camera, math.pi / 4), side()), turned, rtol=1e-5)
    directions = torch.from_numpy(camera.rays(np.array([3.5]), np.array([5.5])))
    seen = LatLongEnvironment(torch.from_numpy(_turned(side(), math.pi / 4))).radiance(directions / directions.norm())
    np.testing.assert_allclose(turned[5, 3], seen[0].numpy(), atol=0.07)  # a texel, and what is between two


def test_an_object_that_turns_does_so_before_a_light_that_stands() -> None:
    frames = frames_of("orbit", 8, sphere(), None, 24)
    pictures = [_behind(frame, side()) for frame in frames]
    assert len(frames) == 8
    for picture in pictures[1:]:
        np.testing.assert_allclose(picture, pictures[0], atol=1e-4)
    centre = frames[0].camera.position * (1, 1, 0)
    assert np.cross(centre, frames[1].camera.position * (1, 1, 0))[2] > 0  # counter-clockwise


def test_a_view_of_any_split_is_seen(tiny: Scene) -> None:
    for name, view in {"train/0001": tiny.train[1], "test/0001": tiny.test[1], tiny.train[9].name: tiny.train[9]}.items():
        (frame,) = frames_of(name, 1, tiny.mesh, tiny, 24)
        np.testing.assert_array_equal(frame.camera.to_world, view.camera.to_world)


def test_stills_are_transparent_and_in_rows(ceiling: Path, light: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert relit(ceiling, [light, light], tmp_path / "a.png", "--exposure", "-1") == 0
    assert capsys.readouterr().out.count("side.exr: exposure -1.00 EV") == 2
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape == (48, 96, 4)
    np.testing.assert_array_equal(picture[:, :48], picture[:, 48:])
    assert picture[0, 0, 3] == 0
    assert picture[24, 24, 3] == 255
    assert relit(ceiling, light, tmp_path / "b.png", "--exposure", "0") == 0
    brighter = np.asarray(Image.open(tmp_path / "b.png"))
    inside = picture[:, :48, 3] == 255
    assert brighter[inside].astype(int).mean() > picture[:, :48][inside].astype(int).mean()


def test_a_run_and_its_asset_are_the_same_object(ceiling: Path, light: Path, tmp_path: Path) -> None:
    for name, what in (("run", ceiling), ("asset", ceiling / "asset.glb")):
        assert relit(what, light, tmp_path / f"{name}.png", "--views", "still", "--background", "light", "--exposure", "0") == 0
    one, other = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in ("run", "asset"))
    assert abs(one - other).mean() < 1.5
    assert one[..., 3].min() == 255


def test_animations_have_a_picture_for_every_step(ceiling: Path, light: Path, tmp_path: Path) -> None:
    assert relit(ceiling, light, tmp_path / "a.webp", "--turn", "4", "--seconds", "2") == 0
    with Image.open(tmp_path / "a.webp") as moving:
        assert (moving.n_frames, moving.size) == (4, (48, 48))
    assert relit(ceiling / "asset.glb", light, tmp_path / "a.gif", "--turn", "3", "--views", "orbit") == 0
    with Image.open(tmp_path / "a.gif") as moving:
        assert (moving.n_frames, moving.info["duration"]) == (3, 1000)
    assert relit(ceiling, light, tmp_path / "a.png", "--views", "test") == 0
    with Image.open(tmp_path / "a.png") as still:
        assert still.size == (48, 4 * 48)  # below each other


def test_mp4_is_written_by_an_encoder_where_there_is_one(
    ceiling: Path, light: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert relit(ceiling, light, tmp_path / "a.mp4", "--turn", "2") == 2
    assert "expected ffmpeg on the PATH, which writes .mp4, found none" in capsys.readouterr().err
    encoder = tmp_path / "ffmpeg"
    encoder.write_text('#!/bin/sh\nfor last; do :; done\n/bin/cat > "$last"\n')
    encoder.chmod(encoder.stat().st_mode | stat.S_IXUSR)
    assert relit(ceiling, light, tmp_path / "a.mp4", "--turn", "2") == 0
    assert (tmp_path / "a.mp4").stat().st_size == 2 * 48 * 48 * 3
    encoder.write_text("#!/bin/sh\n/bin/cat > /dev/null\necho no such codec >&2\nexit 3\n")
    assert relit(ceiling, light, tmp_path / "b.mp4", "--turn", "2") == 1
    assert "ffmpeg ended with status 3: no such codec" in capsys.readouterr().err


def test_a_file_that_cannot_hold_the_pictures_is_refused_before_they_are_drawn(
    ceiling: Path, light: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ia_bench.runs.relighting.draw", lambda *_, **__: pytest.fail("it was drawn"))
    assert relit(ceiling, light, tmp_path / "a.png", "--turn", "400") == 2
    assert "expected at most 16383 pixels along a side, found 48 x 19200" in capsys.readouterr().err


def test_bad_input_is_one_sentence(ceiling: Path, light: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    negative, broken = side(), side().astype(np.float16)
    negative[3, 3] = -1
    broken[2, 5] = np.nan
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {name: broken[..., i].copy() for i, name in enumerate("RGB")}) as file:
        file.write(str(tmp_path / "broken.exr"))
    lights = {"negative": negative, "square": side()[:, :16], "black": 0 * side()}
    for name, texels in lights.items():
        write_exr(tmp_path / f"{name}.exr", texels)
    (tmp_path / "text.hdr").write_text("no picture")
    without = shutil.copytree(ceiling, tmp_path / "without")
    (without / "roughness.exr").unlink()
    out = tmp_path / "a.png"
    cases = {
        "nowhere.hdr: no such file": relit(ceiling, tmp_path / "nowhere.hdr", out),
        "negative.exr: expected radiance, found the negative value -1": relit(ceiling, tmp_path / "negative.exr", out),
        "broken.exr: 1 pixel(s) are NaN or Inf, the first at row 2, column 5": relit(ceiling, tmp_path / "broken.exr", out),
        "square.exr: expected a lat-long map, twice as wide as high, found 16 x 16": relit(ceiling, tmp_path / "square.exr", out),
        "black.exr: expected a light, found a black map": relit(ceiling, tmp_path / "black.exr", out),
        "text.hdr: expected a Radiance picture": relit(ceiling, tmp_path / "text.hdr", out),
        "expected the textures of a run, found no roughness.exr": relit(without, light, out),
        "nothing: expected the folder of a run, or a .glb": relit(tmp_path / "nothing", light, out),
        "--out: expected a name that ends with .png": relit(ceiling, light, tmp_path / "a.bmp"),
        "expected light or white with .gif": relit(ceiling, light, tmp_path / "a.gif", "--background", "transparent"),
        "unknown view 'tst'; did you mean 'test'?": relit(ceiling, light, out, "--views", "tst"),
        "expected one of train/0000, test/0000, novel/0000, found 0000": relit(ceiling, light, out, "--views", "0000"),
        "which has no photographs, found test": relit(ceiling / "asset.glb", light, out, "--views", "test"),
        "turn: expected none with views=test, found 3": relit(ceiling, light, out, "--views", "test", "--turn", "3"),
    }
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ia_bench: ")]
    assert set(cases.values()) == {2}
    assert len(said) == len(cases)
    for sentence, line in zip(cases, said, strict=True):
        assert sentence in line
    assert not out.exists()
