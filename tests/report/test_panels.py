"""Exposure of pictures: what it leaves out, and images in which there is nothing to expose for."""

from __future__ import annotations

import numpy as np
import pytest

from ia_bench.report.panels import exposure


def test_exposure_shows_all_but_the_brightest_hundredth_of_the_foreground() -> None:
    images, masks = np.full((1, 20, 20, 3), 0.5, np.float32), np.ones((1, 20, 20), np.float32)
    images[0, 0, 0], images[0, 10:], masks[0, 10:] = 1e6, 7.0, 0.0
    assert exposure(images, masks) == pytest.approx(2)


def test_exposure_of_no_foreground_is_one() -> None:
    assert exposure(np.full((1, 4, 4, 3), 3.0, np.float32), np.zeros((1, 4, 4), np.float32)) == 1
