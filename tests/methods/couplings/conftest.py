"""A texture, and what the training views show of it."""

import pytest
import torch
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.render.renderer import texture_images


@pytest.fixture(scope="module")
def texture() -> Tensor:
    return 0.2 + 0.6 * torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def seen(problem: Problem, texture: Tensor) -> Tensor:
    """The texture's albedo in every training pixel, through the renderer's own pictures: (P, 3)."""
    return problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, texture))
