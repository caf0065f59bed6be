"""Radiance pictures: pixels worked out by hand, rows of both kinds, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ia_bench.common.errors import InputError
from ia_bench.scenes.rgbe import read_rgbe

HEAD = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n\n"


def test_flat_rows_by_hand(tmp_path: Path) -> None:
    """(128, 64, 32, 129) is 128 * 2^(129 - 136) = 1, a half and a quarter; an exponent of 0 is black."""
    path = tmp_path / "it.hdr"
    path.write_bytes(HEAD + b"-Y 1 +X 3\n" + bytes([128, 64, 32, 129, 255, 0, 1, 136, 9, 9, 9, 0]))
    np.testing.assert_array_equal(read_rgbe(path), [[[1, 0.5, 0.25], [255, 0, 1], [0, 0, 0]]])


def test_encoded_rows_by_hand(tmp_path: Path) -> None:
    """Eight pixels: a run of 8, a run of 5 and 3 single bytes, 8 single bytes, a run of 8."""
    path = tmp_path / "it.hdr"
    row = bytes([2, 2, 0, 8, 136, 7, 133, 1, 3, 2, 3, 4, 8, *range(8), 136, 136])
    path.write_bytes(HEAD + b"-Y 2 +X 8\n" + row + row)
    picture = read_rgbe(path)
    assert picture.shape == (2, 8, 3)
    np.testing.assert_array_equal(picture[0], picture[1])
    np.testing.assert_array_equal(picture[0].T, [[7] * 8, [1, 1, 1, 1, 1, 2, 3, 4], range(8)])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"no picture", "expected a Radiance picture, which begins with #\\?"),
        (HEAD + b"+X 3 -Y 1\n", "expected a size as '-Y rows \\+X columns'"),
        (HEAD.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\n\0\0\0\0", "found 32-bit_rle_xyze"),
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


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such image"):
        read_rgbe(tmp_path / "it.hdr")
