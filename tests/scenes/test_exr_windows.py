"""OpenEXR files that store a part of what they show, or more: pixels are where the picture that is shown has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from ia_bench.common.errors import InputError
from ia_bench.scenes.exr import read_exr

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


def test_what_is_not_stored_is_zero(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", IMAGE[4:15, 9:28], (9, 4))
    expected = np.zeros_like(IMAGE)
    expected[4:15, 9:28] = IMAGE[4:15, 9:28]
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 4), expected)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 3), expected[..., :3])


def test_what_is_beyond_the_picture_is_cut(tmp_path: Path) -> None:
    """Renderers store a margin for filters, on some sides or on all of them."""
    write(tmp_path / "all.exr", np.pad(IMAGE, ((2, 1), (3, 5), (0, 0)), constant_values=9), (-3, -2))
    np.testing.assert_array_equal(read_exr(tmp_path / "all.exr", 4), IMAGE)
    write(tmp_path / "left.exr", np.pad(IMAGE[:, :20], ((0, 0), (3, 0), (0, 0)), constant_values=9), (-3, 0))
    expected = np.where(np.arange(WIDTH)[:, None] < 20, IMAGE, 0)
    np.testing.assert_array_equal(read_exr(tmp_path / "left.exr", 4), expected)


def test_a_window_need_not_begin_at_zero(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", IMAGE, (100, -40), ((100, -40), (100 + WIDTH - 1, -40 + HEIGHT - 1)))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 4), IMAGE)


def test_windows_that_do_not_meet_show_nothing(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", IMAGE, (500, 600))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", 4), np.zeros_like(IMAGE))


def test_a_window_beyond_all_measure_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", IMAGE, (0, 0), ((0, 0), (999_999, 999_999)))
    with pytest.raises(InputError, match=r"a\.exr: expected at most \d+ pixels .*, found 1000000 x 1000000"):
        read_exr(tmp_path / "a.exr", 4)
