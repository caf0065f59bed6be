"""Pictures that are none, each in a format whose decoder has an exception of its own for it, and pictures stored in other turns."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageOps

from ia_bench.common.errors import InputError
from ia_bench.scenes.photograph import open_picture


def with_a_wrong_tag() -> bytes:
    """A JPEG whose other tags cannot be written again once it was turned upright: a whole number stored as text."""
    exif, stored = Image.Exif(), BytesIO()
    exif[0x112], exif[0x100] = 6, 8
    Image.new("RGB", (4, 4)).save(stored, "JPEG", exif=exif)
    content = stored.getvalue()
    assert content.count(b"\x01\x00\x00\x04") == 1
    return content.replace(b"\x01\x00\x00\x04", b"\x01\x00\x00\x02")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("size.ppm", b"P6\n3x 2\n255\n" + bytes(18)),  # ValueError
        ("tags.jpg", with_a_wrong_tag()),  # struct.error
    ],
    ids=["size", "tags"],
)
def test_a_damaged_picture_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}: expected a picture"):
        open_picture(tmp_path / name, upright=True)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_pixels_are_those_of_the_file_unless_turned_upright(tmp_path: Path, suffix: str, orientation: int) -> None:
    """The stored pixels are those that were written; upright ones are what Pillow makes of a PNG, since it turns TIFF by itself."""
    pixels = np.zeros((32, 48, 3), np.uint8)
    pixels[:16, :16], pixels[16:, 32:] = (250, 128, 3), (3, 9, 128)
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


def test_colours_of_lab_are_refused(tmp_path: Path) -> None:
    Image.new("LAB", (4, 3), (120, 9, 9)).save(tmp_path / "a.tif")
    with pytest.raises(InputError, match=r"a\.tif: expected red, green and blue, or grey, found the colours of CIE Lab"):
        open_picture(tmp_path / "a.tif")
