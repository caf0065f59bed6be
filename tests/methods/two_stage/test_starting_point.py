"""Where a fit starts."""

from __future__ import annotations

import torch
from small_fit import SETTINGS

from ia_bench.methods.contract import PixelSamples, Problem
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.start import start_albedo


def test_a_prior_that_was_asked_about_views_without_the_mesh_leaves_the_start_to_the_images(problem: Problem) -> None:
    parameters = Parameters(problem, SETTINGS)
    start_albedo(parameters, problem, 0.5, None)
    expected = parameters.tensors["albedo"].detach().clone()
    images = problem.photographs.radiance
    nothing = PixelSamples({"albedo": torch.zeros_like(images)}, torch.zeros_like(images[:, :1]))
    start_albedo(parameters, problem, 0.5, nothing)
    assert torch.equal(parameters.tensors["albedo"], expected)
    assert float(expected.mean()) > 0.1
