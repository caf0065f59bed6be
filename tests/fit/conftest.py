"""The shipped scene tiny as a problem, under the settings of a run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from small_fit import Record, make_problem

from ia_bench.fit.problem import Problem
from ia_bench.paths import scenes_folder
from ia_bench.scenes.native import load_scene
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Scene tiny with its truth."""
    return load_scene(scenes_folder() / "tiny", truth=True)


@pytest.fixture(scope="session")
def problem(scene: Scene) -> Problem:
    """What a method would be given of it."""
    return make_problem(scene.for_training())


@pytest.fixture(autouse=True)
def deterministic() -> Iterator[None]:
    """As in a run."""
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.fixture
def record() -> Record:
    return Record()
