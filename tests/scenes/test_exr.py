"""Linear pictures, OpenEXR and Radiance, and the sRGB transfer function."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from skimage.color import rgb2xyz, xyz2rgb

from ia_bench.common.errors import InputError
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.exr import read_exr, read_light, read_rgbe, rgbe, write_exr
from ia_bench.scenes.photograph import read_photograph

# ---------------------------------------------------------------- openEXR files that store a part of what they show
# Or more: pixels are where the picture that is shown has them.
HEIGHT, WIDTH = 23, 31
Corner = tuple[int, int]
"""Column and row of a pixel."""


def write(path: Path, image: np.ndarray, first: Corner, shown: tuple[Corner, Corner] = ((0, 0), (WIDTH - 1, HEIGHT - 1))) -> None:
    """The pixels of ``image`` from the column and row ``first`` on, in a picture that shows the window ``shown``."""
    last = (first[0] + image.shape[1] - 1, first[1] + image.shape[0] - 1)
    windows = {"dataWindow": (first, last), "displayWindow": shown}
    header = {key: tuple(np.array(corner, np.int32) for corner in window) for key, window in windows.items()}
    channels = {name: np.ascontiguousarray(image[..., i].astype(np.float32)) for i, name in enumerate("RGBA")}
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, channels) as file:
        file.write(str(path))


IMAGE = np.random.default_rng(0).random((HEIGHT, WIDTH, 4)).astype(np.float32)


def test_what_is_not_stored_is_zero_and_what_is_beyond_the_picture_is_cut(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", IMAGE[4:15, 9:28], (9, 4))
    expected = np.zeros_like(IMAGE)
    expected[4:15, 9:28] = IMAGE[4:15, 9:28]
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 4), expected)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 3), expected[..., :3])
    # renderers store a margin for filters, on some sides or on all of them
    write(tmp_path / "all.exr", np.pad(IMAGE, ((2, 1), (3, 5), (0, 0)), constant_values=9), (-3, -2))
    np.testing.assert_array_equal(read_exr(tmp_path / "all.exr", 4), IMAGE)
    write(tmp_path / "left.exr", np.pad(IMAGE[:, :20], ((0, 0), (3, 0), (0, 0)), constant_values=9), (-3, 0))
    expected = np.where(np.arange(WIDTH)[:, None] < 20, IMAGE, 0)
    np.testing.assert_array_equal(read_exr(tmp_path / "left.exr", 4), expected)


def test_radiance_of_other_primaries_is_refused(tmp_path: Path) -> None:
    """Rec.2020's, as raw converters name them; those of Rec.709, rounded, are as good as none."""
    path, channels = tmp_path / "a.exr", {name: np.full((2, 4), 0.5, np.float32) for name in "RGB"}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    rec709, rec2020 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.3291), (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
    OpenEXR.File({**header, "chromaticities": rec709}, channels).write(str(path))
    assert read_light(path).max() == read_photograph(path)[0].max() == 0.5
    OpenEXR.File({**header, "chromaticities": rec2020}, channels).write(str(path))
    for read in (read_light, read_photograph):
        with pytest.raises(InputError, match=r"a\.exr: expected linear radiance of Rec\.709 .*, found chromaticities \[0\.708, "):
            read(path)


# ---------------------------------------------------------------- radiance pictures
# Pixels worked out by hand, rows of both kinds, and files that are none.
HEAD = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n\n"


def test_flat_and_encoded_rows_by_hand(tmp_path: Path) -> None:
    """(128, 64, 32, 129) is 128 * 2^(129 - 136) = 1, a half and a quarter; an exponent of 0 is black."""
    path = tmp_path / "it.hdr"
    path.write_bytes(HEAD + b"-Y 1 +X 3\n" + bytes([128, 64, 32, 129, 255, 0, 1, 136, 9, 9, 9, 0]))
    np.testing.assert_array_equal(read_rgbe(path), [[[1, 0.5, 0.25], [255, 0, 1], [0, 0, 0]]])
    # eight pixels: a run of 8, a run of 5 and 3 single bytes, 8 single bytes, a run of 8
    row = bytes([2, 2, 0, 8, 136, 7, 133, 1, 3, 2, 3, 4, 8, *range(8), 136, 136])
    path.write_bytes(HEAD + b"-Y 2 +X 8\n" + row + row)
    picture = read_rgbe(path)
    assert picture.shape == (2, 8, 3)
    np.testing.assert_array_equal(picture[0], picture[1])
    np.testing.assert_array_equal(picture[0].T, [[7] * 8, [1, 1, 1, 1, 1, 2, 3, 4], range(8)])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"no picture", "expected a Radiance picture in 32-bit_rle_rgbe, which begins with #\\?"),
        (HEAD + b"+X 3 -Y 1\n", "and has a size as '-Y rows \\+X columns'"),
        (HEAD + b"-Y 0 +X 0\n", "and has a size as '-Y rows \\+X columns'"),
        (HEAD.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\n\0\0\0\0", "in 32-bit_rle_rgbe"),
        (HEAD + b"-Y 2 +X 2\n" + bytes(8), "expected 2 rows of 2 pixels, found damaged or missing data"),
        (HEAD + b"-Y 1 +X 8\n" + bytes([2, 2, 0, 8, 137, 7]), "found damaged or missing data"),
        (HEAD + b"-Y 1 +X 8\n" + bytes([2, 2, 0, 8, 0]), "found damaged or missing data"),
        (HEAD + b"-Y 99999999 +X 99999999\n" + bytes(8), "expected at most 67108864 pixels"),
    ],
)
def test_what_is_no_picture(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "it.hdr").write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_rgbe(tmp_path / "it.hdr")


# ---------------------------------------------------------------- the sRGB curve against skimage and itself
# OpenEXR files against the values written.
CODES = np.linspace(0, 1, 4097)


def test_srgb_against_scikit_image_and_there_and_back() -> None:
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(CODES)), CODES, atol=1e-7)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(3 * CODES)), 3 * CODES, atol=1e-6)
    assert linear_to_srgb(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=1e-9)
    assert (np.diff(linear_to_srgb(np.linspace(-0.1, 2, 9999))) > 0).all()
    # scikit-image decodes on its way to XYZ; Y of a grey is its linear value, whatever the primaries
    grey = np.repeat(CODES[:, None], 3, axis=1)
    np.testing.assert_allclose(srgb_to_linear(CODES), rgb2xyz(grey)[:, 1], atol=1e-5)
    np.testing.assert_allclose(linear_to_srgb(CODES), xyz2rgb(rgb2xyz(linear_to_srgb(grey)))[:, 1], atol=1e-3)


def test_srgb_of_torch_is_the_same_with_finite_gradients() -> None:
    linear = torch.tensor([-0.1, 0.0, 1e-9, 0.003, 0.0031308, 0.0032, 0.5, 1.0, 40.0], dtype=torch.float64)
    linear.requires_grad_()
    encoded = linear_to_srgb(linear)
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


def test_half_overflow_is_refused_and_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "sun.exr"
    write_exr(path, np.full((2, 2), 65504.0))
    with pytest.raises(ValueError, match=r"sun\.exr.*-70000.*half|sun\.exr.*70000.*half"):
        write_exr(path, np.full((2, 2), -70000.0))
    assert read_exr(path, 1).max() == 65504
    write_exr(path, np.full((2, 2), 70000.0), half=False)
    assert read_exr(path, 1).max() == 70000


def test_a_folder_or_garbage_is_no_image(tmp_path: Path) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "garbage.exr").write_bytes(b"v/1\x01 and then nothing")
    for name in ("folder.exr", "garbage.exr", "absent.exr"):
        with pytest.raises(InputError, match=name):
            read_exr(tmp_path / name, 3)


def test_a_picture_that_ends_too_early_is_told_and_nothing_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_exr(tmp_path / "short.exr", np.ones((16, 16, 3)), half=False)
    (tmp_path / "short.exr").write_bytes((tmp_path / "short.exr").read_bytes()[:-40])
    with pytest.raises(InputError, match=r"short\.exr: not a readable OpenEXR file \(.*reading pixel data"):
        read_exr(tmp_path / "short.exr", 3)
    assert capsys.readouterr().out == ""


def test_a_deep_image_is_refused(tmp_path: Path) -> None:
    pixels = np.empty((2, 3), object)
    for place in np.ndindex(2, 3):
        pixels[place] = np.arange(1 + place[1], dtype=np.float32)
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    OpenEXR.File(header, {name: pixels.copy() for name in "RGB"}).write(str(tmp_path / "deep.exr"))
    with pytest.raises(InputError, match=r"deep\.exr: expected one value in a pixel, found several"):
        read_exr(tmp_path / "deep.exr", 3)


def test_radiance_is_divided_by_all_exposures_of_its_header(tmp_path: Path) -> None:
    path, pixel = tmp_path / "it.hdr", b"-Y 1 +X 1\n" + bytes([128, 64, 32, 129])
    path.write_bytes(HEAD.replace(b"FORMAT", b"EXPOSURE=4.0\nEXPOSURE= 0.5\nFORMAT") + pixel)
    np.testing.assert_array_equal(read_rgbe(path), [[[0.5, 0.25, 0.125]]])
    for wrong in (b"bright", b"0", b"nan"):
        path.write_bytes(HEAD.replace(b"FORMAT", b"EXPOSURE=" + wrong + b"\nFORMAT") + pixel)
        with pytest.raises(InputError, match=f"EXPOSURE: expected a number above 0, found {wrong.decode()}"):
            read_rgbe(path)


def test_a_header_of_radiance_is_heeded_and_what_it_cannot_hold_is_told(tmp_path: Path) -> None:
    path, pixel = tmp_path / "it.hdr", b"-Y 1 +X 1\n" + bytes([128, 64, 32, 129])
    path.write_bytes(HEAD.replace(b"FORMAT", b"COLORCORR= 1 2 4\nPRIMARIES= .64 .33 .29 .6 .15 .06 .333 .333\nFORMAT") + pixel)
    np.testing.assert_array_equal(read_rgbe(path), [[[1.0, 0.25, 0.0625]]])
    for line, said in (
        (b"PRIMARIES= 0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.329", "expected linear radiance of Rec.709"),
        (b"PRIMARIES= 1 2", "PRIMARIES: expected 8 numbers, found 1 2"),
        (b"COLORCORR= 1 0 1", "COLORCORR: expected 3 numbers above 0, found 1 0 1"),
    ):
        path.write_bytes(HEAD.replace(b"FORMAT", line + b"\nFORMAT") + pixel)
        with pytest.raises(InputError, match=said):
            read_rgbe(path)
    bright = np.full((2, 4, 3), 3e38, np.float32)
    path.write_bytes(rgbe(bright))
    assert read_rgbe(path).max() == pytest.approx(255 * 2.0**119)  # the most that the format has
    with pytest.raises(ValueError, match="expected finite values"):
        rgbe(np.full((2, 4, 3), np.inf, np.float32))


def test_a_light_that_is_too_bright_for_its_exposure_is_refused(tmp_path: Path) -> None:
    content = rgbe(np.full((2, 4, 3), 1e10, np.float32)).replace(b"rgbe\n\n", b"rgbe\nEXPOSURE=1e-308\n\n")
    (tmp_path / "sun.hdr").write_bytes(content)
    with pytest.raises(InputError, match=r"sun\.hdr: expected radiance up to 1e\+12"):
        read_light(tmp_path / "sun.hdr")
