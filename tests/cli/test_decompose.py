import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from priors.tiny_network import tiny_weights

from ia_bench.cli.decompose import main
from ia_bench.common.errors import InputError
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
    return ["--out", str(out), "--option", f"weights={weights}", "--option", "steps=2", "--samples", "2"]


def test_the_command_writes_every_part_of_a_photograph(tmp_path, weights, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "ia_bench.decompose", str(tmp_path / "disc.png"), *arguments(weights, out)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert ended.returncode == 0, ended.stderr
    assert "2 samples, 4 network evaluations" in ended.stdout
    parts = [f"disc_{part}{kind}.{file}" for part in ("albedo", "specular") for kind in ("", "_spread") for file in ("exr", "png")]
    assert sorted(path.name for path in out.iterdir()) == sorted([*parts, "disc_sheet.png"])
    again = decompose(tmp_path / "disc.png", options={"weights": weights, "steps": 2}, samples=2)
    np.testing.assert_allclose(read_exr(out / "disc_albedo_spread.exr", 4)[..., :3], again.spread["albedo"], atol=1e-6)
    linear = read_exr(out / "disc_albedo.exr", 4)
    np.testing.assert_allclose(linear[..., 3], picture[..., 3] / 255, atol=1e-6)
    assert 0 <= linear.min() <= linear[..., :3].max() <= 1
    inside = linear[..., 3] == 1
    shown = np.asarray(Image.open(out / "disc_albedo.png"), np.float32) / 255
    np.testing.assert_allclose(srgb_to_linear(shown[..., :3])[inside], linear[..., :3][inside], atol=0.006)


def test_from_python_in_three_lines(tmp_path, weights, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    parts = decompose(tmp_path / "disc.png", options={"weights": weights, "steps": 2}, samples=3)
    assert parts.samples == 3
    assert parts.network_calls == 6
    assert parts.spread["albedo"].max() > 0
    assert parts.mean["specular"].shape == (24, 30, 3)
    assert bool((parts.mean["albedo"][parts.mask == 0] == 0).all())


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"samples": 0}, "^samples: expected at least 1, found 0"),
        ({"seed": -1}, "^seed: expected at least 0, found -1"),
        ({"options": {"stepz": 3}}, "did you mean 'prior.options.steps'"),
        ({"options": {"steps": "many"}}, "prior.options.steps: expected a whole number, found 'many'"),
        ({"options": {"weights": "Gewichte (für später)"}}, r"Gewichte \(für später\)/prior.json: no such file"),
    ],
)
def test_mistakes_in_python_are_named(tmp_path, picture, wanted, message):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    with pytest.raises(InputError, match=message):
        decompose(tmp_path / "disc.png", **wanted)


def test_no_option_is_the_default(tmp_path, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    plain, none = (decompose(tmp_path / "disc.png", samples=1, options=options) for options in (None, {"weights": None}))
    np.testing.assert_array_equal(plain.mean["albedo"], none.mean["albedo"])


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
    parts = decompose(tmp_path / "stripes.png", options={"weights": weights, "steps": 1}, samples=1, size=32)
    assert parts.image.shape == (16, 32, 3)
    np.testing.assert_allclose(parts.image, 0.5, atol=1e-6)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_photograph_is_turned_upright(tmp_path, suffix):
    upright = np.zeros((32, 48, 3), np.uint8)
    upright[:16, :24] = (250, 128, 3)
    turned = Image.fromarray(np.rot90(upright).copy())  # a quarter to the left, which orientation 6 undoes
    exif = Image.Exif()
    exif[0x0112] = 6
    lossless = {"quality": 100, "subsampling": 0} if suffix == "jpg" else {}  # but for rounding, since edges lie between blocks
    turned.save(tmp_path / f"turned.{suffix}", exif=exif, **lossless)
    image, mask = read_photograph(tmp_path / f"turned.{suffix}")
    np.testing.assert_allclose(image, srgb_to_linear(upright / 255.0), atol=0.02 if suffix == "jpg" else 1e-6)
    assert mask.min() == 1


def test_the_command_takes_a_mask(tmp_path, weights, picture):
    Image.fromarray(picture[..., :3]).save(tmp_path / "disc.png")
    half = np.zeros((24, 30), np.uint8)
    half[:, :15] = 255
    Image.fromarray(half).save(tmp_path / "half.png")
    out = tmp_path / "out"
    assert main([str(tmp_path / "disc.png"), "--mask", str(tmp_path / "half.png"), *arguments(weights, out)]) == 0
    linear = read_exr(out / "disc_albedo.exr", 4)
    np.testing.assert_allclose(linear[..., 3], half / 255)
    assert linear[:, 15:].max() == 0 < linear[:, :15, :3].max()


def test_alpha_and_mask_multiply(tmp_path, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    half = np.zeros((24, 30), np.uint8)
    half[:, :15] = 255
    Image.fromarray(half).save(tmp_path / "half.png")
    image, mask = read_photograph(tmp_path / "disc.png", tmp_path / "half.png")
    np.testing.assert_allclose(mask, picture[..., 3] / 255 * (half / 255), atol=1e-6)
    np.testing.assert_allclose(image, srgb_to_linear(picture[..., :3] / 255.0) * mask[..., None], atol=1e-6)


def test_exr_is_taken_as_linear_and_premultiplied(tmp_path):
    pixels = np.full((4, 5, 4), 0.25, np.float32)
    pixels[..., :3] = 2.5
    write_exr(tmp_path / "bright.exr", pixels)
    image, mask = read_photograph(tmp_path / "bright.exr")
    assert image.max() == 2.5
    assert mask.max() == 0.25


def test_sixteen_bits_of_grey_reach_white(tmp_path):
    Image.fromarray(np.full((4, 4), 65535, np.uint16)).save(tmp_path / "grey.png")
    assert read_photograph(tmp_path / "grey.png")[0].min() == 1


def test_sixteen_bits_of_a_mask_are_not_cut_at_255(tmp_path, picture):
    Image.fromarray(picture[..., :3]).save(tmp_path / "disc.png")
    ramp = np.tile(np.linspace(0, 65535, 30).astype(np.uint16), (24, 1))
    Image.fromarray(ramp).save(tmp_path / "ramp.png")
    mask = read_photograph(tmp_path / "disc.png", tmp_path / "ramp.png")[1]
    np.testing.assert_allclose(mask, ramp / 65535, atol=1e-6)


@pytest.mark.parametrize("value", [-1, 70_000])
def test_greys_beyond_sixteen_bits_are_refused(tmp_path, value):
    Image.fromarray(np.full((4, 4), value, np.int32)).save(tmp_path / "grey.tif")
    with pytest.raises(InputError, match=f"grey.tif: expected values from 0 to 65535, found {value} to {value}"):
        read_photograph(tmp_path / "grey.tif")


def test_alpha_of_another_range_is_refused(tmp_path):
    pixels = np.ones((4, 5, 4), np.float32)
    pixels[1, 2, 3] = 255
    write_exr(tmp_path / "bytes.exr", pixels)
    with pytest.raises(InputError, match=r"bytes.exr: expected alpha from 0 to 1, found 255 in 1 pixel\(s\)"):
        read_photograph(tmp_path / "bytes.exr")


def test_a_palette_with_a_transparent_colour_is_a_cut_out(tmp_path, picture):
    """As a mask it says what it says as a picture."""
    inside = picture[..., 3] > 127
    indexed = Image.fromarray(inside.astype(np.uint8), mode="P")
    indexed.putpalette([255, 255, 255, 200, 100, 50])
    indexed.save(tmp_path / "cut.png", transparency=0)
    Image.fromarray(picture[..., :3]).save(tmp_path / "disc.png")
    for paths in (["cut.png"], ["disc.png", "cut.png"]):
        np.testing.assert_array_equal(read_photograph(*(tmp_path / path for path in paths))[1], inside)


@pytest.mark.parametrize("role", ["photograph", "mask"])
def test_floating_point_without_a_known_white_is_refused(tmp_path, picture, role):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    Image.fromarray(np.full((24, 30), 0.5, np.float32)).save(tmp_path / "grey.tif")
    paths = ("grey.tif",) if role == "photograph" else ("disc.png", "grey.tif")
    with pytest.raises(InputError, match="grey.tif: expected whole numbers, found floating point"):
        read_photograph(*(tmp_path / path for path in paths))


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"not a picture", "expected a picture"), (None, "no such image")],
)
def test_what_is_no_picture_is_refused_by_name(tmp_path, content, message):
    path = tmp_path / "photo.jpg"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=f"photo.jpg.*{message}"):
        read_photograph(path)


@pytest.mark.parametrize(
    "name",
    ["a" * 5000, "a/" * 3000, "\udcff.png", "line\nbreak.png", "folder.png", "loop.png", "folder.exr", "loop.exr"],
    ids=["long", "deep", "surrogate", "two lines", "folder.png", "loop.png", "folder.exr", "loop.exr"],
)
@pytest.mark.parametrize("role", ["photograph", "mask"])
def test_a_path_that_is_no_picture_is_one_line(tmp_path, picture, monkeypatch, capsys, name, role):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(picture).save("disc.png")
    for suffix in ("png", "exr"):
        Path(f"folder.{suffix}").mkdir()
        Path(f"loop.{suffix}").symlink_to(f"loop.{suffix}")
    assert main([name] if role == "photograph" else ["disc.png", "--mask", name]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no such image" in err
    err.encode()  # what a terminal can print
    assert len(err) < 500


def test_masks_of_another_size_and_empty_ones_are_refused(tmp_path, picture):
    Image.fromarray(picture).save(tmp_path / "disc.png")
    Image.fromarray(np.full((5, 5), 255, np.uint8)).save(tmp_path / "small.png")
    with pytest.raises(InputError, match=r"small.png: expected 30 x 24 pixels .* found 5 x 5"):
        read_photograph(tmp_path / "disc.png", tmp_path / "small.png")
    Image.fromarray(np.zeros((24, 30), np.uint8)).save(tmp_path / "none.png")
    with pytest.raises(InputError, match="none.png: the mask has no pixel"):
        read_photograph(tmp_path / "disc.png", tmp_path / "none.png")


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--prior", "difusion"], "did you mean 'prior=diffusion'|did you mean 'diffusion'"),
        (["--prior", "oracle"], "needs ground truth"),
        (["--prior", "none"], "provides nothing"),
        (["--option", "stepz=3"], "did you mean"),
        (["--option", "steps"], "expected KEY=VALUE"),
        (["--samples", "0"], "--samples: expected at least 1"),
    ],
)
def test_mistakes_end_in_one_line(tmp_path, picture, capsys, extra, message):
    import re

    Image.fromarray(picture).save(tmp_path / "disc.png")
    assert main([str(tmp_path / "disc.png"), "--out", str(tmp_path / "out"), *extra]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_undershoots_of_lossy_compression_are_mended_and_told_and_larger_ones_refused(tmp_path):
    pixels = np.full((4, 5, 3), 2.0, np.float32)
    pixels[0, :2] = -0.01
    write_exr(tmp_path / "lossy.exr", pixels)
    told: list[str] = []
    image, _ = read_photograph(tmp_path / "lossy.exr", notice=told.append)
    assert image.min() == 0
    assert len(told) == 1
    assert "lossy.exr: 2 pixels are below zero" in told[0]
    pixels[0, 0] = -0.25
    write_exr(tmp_path / "wrong.exr", pixels)
    with pytest.raises(InputError, match=r"wrong.exr: expected radiance, found the negative value -0.25"):
        read_photograph(tmp_path / "wrong.exr")
