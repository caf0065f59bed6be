"""Pictures: what decoders refuse, turns, colour profiles."""

import struct
import warnings
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageOps, features

from ia_bench.common.errors import InputError
from ia_bench.readers.pictures import recorded_exposure
from ia_bench.scenes import photograph
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.photograph import open_picture, read_arrays, read_mask, read_photograph, read_stored, read_values


# ---------------------------------------------------------------- pictures that are none
# Each in a format whose decoder has an exception of its own for it, and pictures stored in other turns.
def test_a_damaged_picture_and_colours_of_lab_are_told_and_damaged_exif_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "size.ppm").write_bytes(b"P6\n3x 2\n255\n" + bytes(18))  # at which Pillow raises a ValueError
    with pytest.raises(InputError, match="size.ppm: expected a picture"):
        open_picture(tmp_path / "size.ppm", upright=True)
    Image.new("LAB", (3, 2)).save(tmp_path / "lab.tif")
    with pytest.raises(InputError, match="lab.tif: expected red, green and blue, or grey, found the colours of CIE Lab"):
        read_photograph(tmp_path / "lab.tif")
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    Image.fromarray(pixels).save(tmp_path / "damaged.png", exif=b"Exif\0\0no record")
    assert recorded_exposure(tmp_path / "damaged.png") is None
    np.testing.assert_array_equal(np.asarray(open_picture(tmp_path / "damaged.png", upright=True)), pixels)


def test_sizes_are_read_before_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of some kilobytes that would fill the memory; Pillow, too, warns of the second."""
    for side in (9000, 13000):
        Image.new("1", (side, side)).save(tmp_path / "large.png")
        with (
            warnings.catch_warnings(action="error"),
            pytest.raises(InputError, match=rf"large.png: expected at most 67108864 pixels \(8192 x 8192\), found {side} x {side}"),
        ):
            open_picture(tmp_path / "large.png", upright=True)
    monkeypatch.setattr(photograph, "MAX_PIXELS", 1000)
    np.savez_compressed(tmp_path / "large.npz", matrix=np.zeros(4001))
    with pytest.raises(InputError, match="large.npz: expected arrays of at most 4000 numbers, found one of "):
        read_arrays(tmp_path / "large.npz", lambda name: True)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(
    ("suffix", "mode"), [(suffix, "RGB") for suffix in ("png", "jpg", "tif")] + [("tif", mode) for mode in ("L", "I;16", "RGBA")]
)
def test_pixels_are_those_of_the_file_unless_turned_upright(tmp_path: Path, suffix: str, mode: str, orientation: int) -> None:
    """The stored pixels are those that were written; upright ones are what Pillow makes of a PNG, since it turns TIFF by itself."""
    pixels = np.zeros((32, 48, 4), np.uint8)
    pixels[:16, :16], pixels[16:, 32:] = (250, 128, 3, 255), (3, 9, 128, 77)
    pixels = pixels[..., 0] * np.uint16(257) if mode == "I;16" else pixels[..., 0] if mode == "L" else pixels[..., : len(mode)]
    exif = Image.Exif()
    exif[0x112] = orientation
    tag: dict[str, Any] = {"tiffinfo": {0x112: orientation}} if suffix == "tif" else {"exif": exif}
    lossless = {"quality": 100, "subsampling": 0} if suffix == "jpg" else {}
    Image.fromarray(pixels).save(tmp_path / f"turned.{suffix}", **tag, **lossless)
    Image.fromarray(pixels).save(tmp_path / "turned_reference.png", exif=exif)
    with Image.open(tmp_path / "turned_reference.png") as file:
        upright = np.asarray(ImageOps.exif_transpose(file)).astype(int)
    for expected, found in ((pixels, False), (upright, True)):
        values = np.asarray(open_picture(tmp_path / f"turned.{suffix}", upright=found)).astype(int)
        assert values.shape == expected.shape
        assert np.abs(values - expected).max() <= (3 if suffix == "jpg" else 0)


# ---------------------------------------------------------------- photographs with a colour profile
# Against the matrix between the two colour spaces computed from their chromaticities.
D65 = (0.3127, 0.3290)
SRGB = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
DISPLAY_P3 = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
D50 = np.array([0.9642, 1.0, 0.8249])


def xyz(chromaticity: tuple[float, float]) -> np.ndarray:
    x, y = chromaticity
    return np.array([x / y, 1, (1 - x - y) / y])


def to_xyz(primaries: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Linear red, green and blue of white D65 to CIE XYZ (3, 3)."""
    columns = np.stack([xyz(primary) for primary in primaries], -1)
    return columns * np.linalg.solve(columns, xyz(D65))


def profile(name: str, primaries: tuple[tuple[float, float], ...], curve: tuple[float, ...] = SRGB_CURVE) -> bytes:
    """An ICC profile of version 4: a matrix and one parametric curve ((a v + b)^g above d, c v below; or v^g) for all channels."""
    adapted = np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ D50) / (BRADFORD @ xyz(D65))) @ BRADFORD @ to_xyz(primaries)

    def text(words: str) -> bytes:
        return b"mluc" + struct.pack(">3I", 0, 1, 12) + b"enUS" + struct.pack(">2I", 2 * len(words), 28) + words.encode("utf-16-be")

    def place(values: np.ndarray) -> bytes:
        return b"XYZ " + struct.pack(">I3i", 0, *(round(65536 * value) for value in values))

    kind = {1: 0, 5: 3}[len(curve)]
    tone = b"para" + struct.pack(f">IHH{len(curve)}i", 0, kind, 0, *(round(65536 * value) for value in curve))
    tags = {b"desc": text(name), b"cprt": text("none"), b"wtpt": place(D50)}
    tags |= {c.encode() + b"XYZ": place(adapted[:, i]) for i, c in enumerate("rgb")}
    tags |= {c.encode() + b"TRC": tone for c in "rgb"}
    listed, body = struct.pack(">I", len(tags)), b""
    for tag, value in tags.items():
        listed += tag + struct.pack(">2I", 132 + 12 * len(tags) + len(body), len(value))
        body += value + bytes(-len(value) % 4)
    head = struct.pack(">I4x", 132 + 12 * len(tags) + len(body)) + b"\x04\x20\0\0mntrRGB XYZ " + bytes(12) + b"acsp" + bytes(28)
    return head + struct.pack(">3i", *(round(65536 * value) for value in D50)) + bytes(48) + listed + body


P3 = profile("Display P3", DISPLAY_P3)
COLOURS = np.random.default_rng(0).integers(70, 180, (5, 7, 3)).astype(np.uint8)  # within the gamut of sRGB


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
@pytest.mark.parametrize("upright", [True, False])
def test_display_p3_becomes_srgb(tmp_path: Path, suffix: str, upright: bool) -> None:
    expected = srgb_to_linear(COLOURS / 255.0) @ (np.linalg.inv(to_xyz(SRGB)) @ to_xyz(DISPLAY_P3)).T
    written = {"quality": 100, "subsampling": 0} if suffix == "jpg" else {}
    Image.fromarray(COLOURS).save(tmp_path / f"a.{suffix}", icc_profile=P3, **written)
    image, _ = read_photograph(tmp_path / f"a.{suffix}", upright=upright)
    np.testing.assert_allclose(image, expected, atol=0.03 if suffix == "jpg" else 0.005)
    assert np.abs(srgb_to_linear(COLOURS / 255.0) - expected).max() > 0.05


def test_a_linear_curve_is_undone_and_alpha_kept(tmp_path: Path) -> None:
    """A profile whose name says sRGB need not be sRGB."""
    alpha = np.arange(35, dtype=np.uint8).reshape(5, 7) * 7
    linear = profile("Linear sRGB", SRGB, (1.0,))
    Image.fromarray(np.dstack([COLOURS, alpha])).save(tmp_path / "a.png", icc_profile=linear)
    image, mask = read_photograph(tmp_path / "a.png")
    np.testing.assert_array_equal(mask, np.float32(alpha) / 255)
    np.testing.assert_allclose(image, COLOURS / 255.0 * mask[..., None], atol=0.005)


def test_masks_and_maps_are_values_and_no_colours(tmp_path: Path) -> None:
    Image.fromarray(COLOURS).save(tmp_path / "a.png", icc_profile=P3)
    np.testing.assert_array_equal(read_values(tmp_path / "a.png")[..., :3], np.float32(COLOURS) / 255)
    Image.fromarray(grey := COLOURS[..., :1].repeat(3, -1)).save(tmp_path / "mask.png", icc_profile=P3)
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png"), np.float32(grey[..., 0]) / 255)


@pytest.mark.parametrize(
    ("picture", "content", "name"),
    [
        (Image.fromarray(COLOURS[..., 0]), P3, "Display P3"),
        (Image.fromarray(COLOURS[..., 0].astype(np.uint16) * 257), P3, "Display P3"),
        (Image.fromarray(COLOURS), b"none at all", "(damaged)"),
    ],
    ids=["grey", "16 bits", "damaged"],
)
def test_a_profile_that_cannot_be_applied_is_told(tmp_path: Path, picture: Image.Image, content: bytes, name: str) -> None:
    told: list[str] = []
    picture.save(tmp_path / "a.png", icc_profile=content)
    image, _ = read_photograph(tmp_path / "a.png", notice=told.append)
    assert told == [f"{tmp_path / 'a.png'}: its colour profile {name} is ignored, and sRGB assumed"]
    picture.save(tmp_path / "plain.png")
    np.testing.assert_array_equal(image, read_photograph(tmp_path / "plain.png", notice=told.append)[0])
    assert len(told) == 1


def test_adobe_rgb_that_is_named_without_a_profile_is_told(tmp_path: Path) -> None:
    """As cameras write it into their JPEG."""
    told, record = list[str](), Image.Exif()
    record.get_ifd(0x8769)[0xA005] = {1: "R03"}
    Image.fromarray(COLOURS).save(tmp_path / "_a.jpg", exif=record)
    read_photograph(tmp_path / "_a.jpg", notice=told.append)
    assert told == [f"{tmp_path / '_a.jpg'}: its colour space Adobe RGB is ignored, and sRGB assumed"]


# ---------------------------------------------------------------- what a picture says of itself
def png(colour: int, values: np.ndarray, *chunks: bytes) -> bytes:
    """A PNG of 16 bits a channel, whose ``colour`` type has as many channels as ``values`` (H, W, C); written by hand."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    header = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 16, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("colour", "channels", "told"), [(0, 1, 0), (2, 3, 1), (4, 2, 1), (6, 4, 1)])
def test_bits_that_are_lost_are_told(tmp_path: Path, colour: int, channels: int, told: int) -> None:
    """Of a picture in grey all 16 are kept."""
    (tmp_path / "deep.png").write_bytes(png(colour, np.full((2, 3, channels), 0xFE80)))
    notes: list[str] = []
    radiance, coverage = read_photograph(tmp_path / "deep.png", notice=notes.append)
    assert len(notes) == told
    assert all("deep.png: its 16 bits a channel are read as 8" in note for note in notes)
    kept = srgb_to_linear(np.array(0xFE80 / 65535 if not told else 0xFE / 255)) * coverage
    np.testing.assert_allclose(radiance[..., 0], kept, rtol=1e-5)


@pytest.mark.skipif(not features.check("avif"), reason="Pillow was built without AVIF")
def test_a_damaged_avif_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "it.avif"
    Image.new("RGB", (16, 16), "red").save(path)
    path.write_bytes(path.read_bytes()[:-40].replace(b"pict", b"pixt"))
    with pytest.raises(InputError, match=r"it\.avif: expected a picture"):
        read_photograph(path)


def test_numbers_beyond_float32_are_told(tmp_path: Path) -> None:
    np.save(tmp_path / "it.npy", np.full((2, 2, 3), 1e39))
    with pytest.raises(InputError, match=r"it\.npy: expected values that float32 can hold, found 1e\+39"):
        read_stored(tmp_path / "it.npy")


def test_damaged_arrays_are_one_sentence(tmp_path: Path) -> None:
    """An array under the name of an archive, and bytes that are others anywhere in an archive."""
    with (tmp_path / "array.npz").open("wb") as file:
        np.save(file, np.ones(3))
    np.savez_compressed(tmp_path / "whole.npz", a=np.arange(60.0))
    whole = (tmp_path / "whole.npz").read_bytes()
    refused = 0
    for place in range(len(whole)):
        (tmp_path / "other.npz").write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        with suppress(InputError):
            read_arrays(tmp_path / "other.npz", lambda name: True)
            refused -= 1
        refused += 1
    assert refused > 100
    with pytest.raises(InputError, match=r"array\.npz: expected arrays of numbers"):
        read_arrays(tmp_path / "array.npz", lambda name: True)
