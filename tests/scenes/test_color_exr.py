"""The sRGB curve against skimage and itself; OpenEXR files against the values written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from skimage.color import rgb2xyz, xyz2rgb

from ia_bench.common.errors import InputError
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.color import linear_to_srgb as linear_to_srgb_torch
from ia_bench.scenes.exr import read_exr, write_exr

CODES = np.linspace(0, 1, 4097)


def test_srgb_round_trip() -> None:
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(CODES)), CODES, atol=1e-7)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(3 * CODES)), 3 * CODES, atol=1e-6)
    assert linear_to_srgb(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=1e-9)
    assert (np.diff(linear_to_srgb(np.linspace(-0.1, 2, 9999))) > 0).all()


def test_srgb_against_scikit_image() -> None:
    """scikit-image decodes on its way to XYZ; Y of a grey is its linear value, whatever the primaries."""
    grey = np.repeat(CODES[:, None], 3, axis=1)
    np.testing.assert_allclose(srgb_to_linear(CODES), rgb2xyz(grey)[:, 1], atol=1e-5)
    np.testing.assert_allclose(linear_to_srgb(CODES), xyz2rgb(rgb2xyz(linear_to_srgb(grey)))[:, 1], atol=1e-3)


def test_srgb_of_torch_is_the_same_with_finite_gradients() -> None:
    linear = torch.tensor([-0.1, 0.0, 1e-9, 0.003, 0.0031308, 0.0032, 0.5, 1.0, 40.0], dtype=torch.float64)
    linear.requires_grad_()
    encoded = linear_to_srgb_torch(linear)
    np.testing.assert_allclose(encoded.detach().numpy(), linear_to_srgb(linear.detach().numpy()), rtol=1e-12)
    (gradient,) = torch.autograd.grad(encoded.sum(), linear)
    step = 1e-7
    expected = [(linear_to_srgb(x + step) - linear_to_srgb(x - step)) / (2 * step) for x in linear.detach().numpy()]
    away = [0, 1, 2, 3, 5, 6, 7, 8]  # not at the kink
    np.testing.assert_allclose(gradient.numpy()[away], np.array(expected)[away], rtol=1e-5)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("half", [True, False])
def test_exr_round_trip(tmp_path: Path, channels: int, half: bool) -> None:
    """Channels, rows and columns come back where they were; half floats are off by their rounding only."""
    image = np.random.default_rng(0).normal(0, 50, (37, 31, channels)).astype(np.float32)
    write_exr(tmp_path / "deep" / "a.exr", image, half=half)
    back = read_exr(tmp_path / "deep" / "a.exr", channels)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, image.astype(np.float16).astype(np.float32) if half else image)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["a.exr"]  # no partial file is left


def test_exr_of_two_dimensions(tmp_path: Path) -> None:
    write_exr(tmp_path / "depth.exr", np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(read_exr(tmp_path / "depth.exr", 1)[..., 0], [[0, 1, 2], [3, 4, 5]])


def test_half_overflow_is_refused_and_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "sun.exr"
    write_exr(path, np.full((2, 2), 65504.0))
    with pytest.raises(ValueError, match=r"sun\.exr.*-70000.*half|sun\.exr.*70000.*half"):
        write_exr(path, np.full((2, 2), -70000.0))
    assert read_exr(path, 1).max() == 65504
    write_exr(path, np.full((2, 2), 70000.0), half=False)
    assert read_exr(path, 1).max() == 70000


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_could_not_be_read_is_not_written(tmp_path: Path, bad: float) -> None:
    with pytest.raises(ValueError, match=r"a\.exr.*(NaN|inf)"):
        write_exr(tmp_path / "a.exr", np.array([[1.0, bad]]))
    assert not (tmp_path / "a.exr").exists()


def test_a_folder_or_garbage_is_no_image(tmp_path: Path) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "garbage.exr").write_bytes(b"v/1\x01 and then nothing")
    for name in ("folder.exr", "garbage.exr", "absent.exr"):
        with pytest.raises(InputError, match=name):
            read_exr(tmp_path / name, 3)
