import os
import re
import subprocess
import sys
import weakref

import numpy as np
import pytest
from PIL import Image
from priors.tiny_network import tiny_weights

from ia_bench.cli.decompose import main
from ia_bench.common.errors import InputError
from ia_bench.priors.contract import PriorInfo, Samples
from ia_bench.runs.decomposition import decompose
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import read_exr, write_exr
from ia_bench.scenes.photograph import read_photograph


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return tiny_weights(tmp_path_factory.mktemp("weights") / "diffusion")


@pytest.fixture
def picture():
    """(24, 30, 4) uint8: a coloured disc, cut out by its alpha."""
    rows, columns = np.mgrid[:24, :30]
    alpha = np.clip(10 - np.hypot(rows - 11, columns - 16), 0, 1)
    colour = np.stack([rows * 8, columns * 7, 200 - rows * 5], -1)
    return np.dstack([colour, 255 * alpha]).astype(np.uint8)


def arguments(weights, out):
    return ["--out", str(out), "--prior", "diffusion", "--option", f"weights={weights}", "--option", "steps=2", "--samples", "2"]


def test_the_command_writes_every_part_of_a_photograph(tmp_path, weights, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "ia_bench", "decompose", str(tmp_path / "disc.png"), *arguments(weights, out)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert ended.returncode == 0, ended.stderr
    assert "2 samples, 4 network evaluations" in ended.stdout
    parts = [f"disc_{part}{kind}.{file}" for part in ("albedo", "specular") for kind in ("", "_spread") for file in ("exr", "png")]
    assert sorted(path.name for path in out.iterdir()) == sorted([*parts, "disc_sheet.png"])
    again = decompose(tmp_path / "disc.png", prior="diffusion", options={"weights": weights, "steps": 2}, samples=2)
    np.testing.assert_allclose(read_exr(out / "disc_albedo_spread.exr", 4)[..., :3], again.spread["albedo"], atol=1e-6)
    linear = read_exr(out / "disc_albedo.exr", 4)
    np.testing.assert_allclose(linear[..., 3], picture[..., 3] / 255, atol=1e-6)
    assert 0 <= linear.min() <= linear[..., :3].max() <= 1
    inside = linear[..., 3] == 1
    shown = np.asarray(Image.open(out / "disc_albedo.png"), np.float32) / 255
    np.testing.assert_allclose(srgb_to_linear(shown[..., :3])[inside], linear[..., :3][inside], atol=0.006)


class Bytes:
    """An albedo of 0 to 255, which would be written as a white picture."""

    info = PriorInfo(frozenset({"albedo"}))

    def sample(self, observations, *, seed, guidance=None):
        return Samples({"albedo": 255 * observations.images.clamp(0, 1)})


def test_an_albedo_that_is_none_is_told(tmp_path, picture, caplog):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    decompose(tmp_path / "disc.png", prior=f"{__name__}:Bytes")
    (line,) = caplog.messages
    assert re.fullmatch(r"prior Bytes proposes an albedo up to [\d.]+, expected 0 to 1; it is used, .*", line)


def test_results_that_cannot_be_written_are_said_before_sampling(tmp_path, weights, picture, capsys):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    (tmp_path / "out").touch()
    assert main([str(tmp_path / "disc.png"), *arguments(weights, tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert told.err == f"ia_bench: --out: {tmp_path / 'out'}: expected a folder that can be written, found: File exists\n"
    assert "samples" not in told.out


def test_large_pictures_are_reduced_in_linear_light(tmp_path, weights):
    stripes = np.zeros((64, 128, 3), np.uint8)
    stripes[:, ::2] = 255
    Image.fromarray(stripes).save(tmp_path / "stripes.png")
    parts = decompose(tmp_path / "stripes.png", prior="diffusion", options={"weights": weights, "steps": 1}, samples=1, size=32)
    assert parts.image.shape == (16, 32, 3)
    np.testing.assert_allclose(parts.image, 0.5, atol=1e-6)


def test_pictures_are_reduced_one_by_one_and_written_whole_or_not_at_all(tmp_path, weights, monkeypatch):
    large = []

    def read(path, mask, notice):
        assert [one() for one in large] == [None] * len(large)
        radiance = np.full((64, 64, 3), 0.5, np.float32)
        large.append(weakref.ref(radiance))
        return radiance, np.ones((64, 64), np.float32)

    def save(picture, path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("ia_bench.cli.decompose.read_photograph", read)
    monkeypatch.setattr(Image.Image, "save", save)
    assert main(["a.png", "b.png", *arguments(weights, tmp_path / "out"), "--size", "16"]) == 130
    assert len(large) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a_albedo.exr"]


def test_values_of_a_photograph_and_its_mask(tmp_path, picture):
    """Alpha and mask multiply, an EXR is linear and premultiplied, sixteen bits reach white, a transparent colour cuts out."""
    Image.fromarray(picture).save(tmp_path / "disc.png")
    ramp = np.tile(np.linspace(0, 65535, 30).astype(np.uint16), (24, 1))
    Image.fromarray(ramp).save(tmp_path / "ramp.png")
    image, mask = read_photograph(tmp_path / "disc.png", tmp_path / "ramp.png")
    np.testing.assert_allclose(mask, picture[..., 3] / 255 * (ramp / 65535), atol=1e-6)
    np.testing.assert_allclose(image, srgb_to_linear(picture[..., :3] / 255.0) * mask[..., None], atol=1e-6)
    assert read_photograph(tmp_path / "ramp.png")[0].max() == 1
    pixels = np.full((4, 5, 4), 0.25, np.float32)
    pixels[..., :3] = 2.5
    pixels[0, :2, :3] = -0.01  # of lossy compression
    write_exr(tmp_path / "bright.exr", pixels)
    told: list[str] = []
    image, mask = read_photograph(tmp_path / "bright.exr", notice=told.append)
    assert (image.min(), image.max(), mask.max()) == (0, 2.5, 0.25)
    assert "bright.exr: 2 pixels are below zero" in told[0]
    inside = picture[..., 3] > 127
    indexed = Image.fromarray(inside.astype(np.uint8), mode="P")
    indexed.putpalette([255, 255, 255, 200, 100, 50])
    indexed.save(tmp_path / "cut.png", transparency=0)
    Image.fromarray(picture[..., :3]).save(tmp_path / "plain.png")
    for paths in (["cut.png"], ["plain.png", "cut.png"]):
        np.testing.assert_array_equal(read_photograph(*(tmp_path / path for path in paths))[1], inside)


@pytest.mark.parametrize(
    ("pixels", "name", "message"),
    [
        (np.full((24, 30), -1, np.int32), "a.tif", "expected values from 0 to 65535, found -1 to -1"),
        (np.full((24, 30), 0.5, np.float32), "a.tif", "expected whole numbers, found floating point"),
        (np.full((24, 30, 4), 255, np.float32), "a.exr", "expected alpha from 0 to 1, found 255 in"),
        (np.full((24, 30, 3), -0.25, np.float32), "a.exr", "expected radiance, found the negative value -0.25"),
        (b"not a picture", "a.jpg", "expected a picture"),
        (None, "a.jpg", "no such image"),
    ],
)
def test_what_is_no_photograph_is_refused_by_name(tmp_path, pixels, name, message):
    if isinstance(pixels, bytes):
        (tmp_path / name).write_bytes(pixels)
    elif name.endswith(".exr"):
        write_exr(tmp_path / name, pixels)
    elif pixels is not None:
        Image.fromarray(pixels).save(tmp_path / name)
    with pytest.raises(InputError, match=f"{name}.*{message}"):
        read_photograph(tmp_path / name)


@pytest.mark.parametrize(
    ("size", "value", "message"),
    [(5, 255, r"mask.png: expected 30 x 24 pixels .* found 5 x 5"), (None, 0, "mask.png: the mask has no pixel")],
)
def test_masks_of_another_size_and_empty_ones_are_refused(tmp_path, picture, size, value, message):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    Image.fromarray(np.full((size or 24, size or 30), value, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match=message):
        read_photograph(tmp_path / "disc.png", tmp_path / "mask.png")
