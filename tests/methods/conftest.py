"""The shipped scene tiny as a problem, under the settings of a run, and a texture with what its training views show of that."""

from collections.abc import Iterator

import pytest
import torch
from small_fit import Record, make_problem
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.render.renderer import texture_images
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
    """Deterministic algorithms."""
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.fixture(scope="module")
def texture() -> Tensor:
    return 0.2 + 0.6 * torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def seen(problem: Problem, texture: Tensor) -> Tensor:
    """The texture's albedo in every training pixel, through the renderer's own pictures: (P, 3)."""
    return problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, texture))


@pytest.fixture
def record() -> Record:
    return Record()
