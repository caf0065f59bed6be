"""The shipped scene tiny as a problem, under the settings of a run."""

from collections.abc import Iterator

import pytest
import torch
from small_fit import Record, make_problem

from ia_bench.methods.contract import Problem
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="session")
def scene(tiny: Scene) -> Scene:
    """Scene tiny with its truth."""
    return tiny


@pytest.fixture(scope="session")
def problem(scene: Scene) -> Problem:
    """What a method would be given of it."""
    return make_problem(scene.blind())


@pytest.fixture(autouse=True, scope="module")
def as_in_a_run() -> Iterator[None]:
    """Deterministic algorithms, and one thread: work this small only waits for a second one."""
    threads = torch.get_num_threads()
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(1)
    yield
    torch.use_deterministic_algorithms(False)
    torch.set_num_threads(threads)


@pytest.fixture
def record() -> Record:
    return Record()
