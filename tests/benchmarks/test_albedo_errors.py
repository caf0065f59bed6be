"""benchmarks/albedo_errors.py: which scale an error belongs to."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))  # scripts import each other; names of tests first
from albedo_errors import squares_by_scale

ROWS, COLUMNS = np.mgrid[:64, :64]
INSIDE = (ROWS - 32) ** 2 + (COLUMNS - 32) ** 2 < 25**2


@pytest.mark.parametrize(
    ("pattern", "share"),
    [((-1.0) ** (ROWS + COLUMNS), 0), (np.sin(2 * np.pi * COLUMNS / 12), 1), (np.ones((64, 64)), 2)],
    ids=["checkerboard", "waves of 12 pixels", "constant"],
)
def test_an_error_counts_at_its_scale(pattern: np.ndarray, share: int) -> None:
    error = (pattern * INSIDE)[None, ..., None].repeat(3, -1)
    found = squares_by_scale(error, INSIDE[None])
    assert found.sum() == pytest.approx(1)
    assert found[share] > 0.8
