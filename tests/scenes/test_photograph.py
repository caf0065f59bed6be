"""Pictures that are none, each in a format whose decoder has an exception of its own for it."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image

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
        open_picture(tmp_path / name)
