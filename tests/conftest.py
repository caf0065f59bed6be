"""What every test shares: one thread, the shipped scene `tiny`, and a copy of it that may be broken."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch

from ia_bench.readers.native import NativeReader
from ia_bench.scenes.scene import Scene

torch.set_num_threads(1)  # the arrays here are small: more threads only wait for each other

TINY = Path(__file__).resolve().parents[1] / "datasets" / "scenes" / "tiny"


@pytest.fixture(scope="session")
def tiny_folder() -> Path:
    """The shipped 32 x 32 scene; read only."""
    return TINY


@pytest.fixture(scope="session")
def tiny() -> Scene:
    """The shipped 32 x 32 scene with its ground truth."""
    return NativeReader(TINY).read(truth=True)


@pytest.fixture
def tiny_copy(tmp_path: Path) -> Path:
    """A copy of `tiny` to break in one place; what it looks like before is checked by the test of the shipped scene."""
    return Path(shutil.copytree(TINY, tmp_path / "tiny"))
