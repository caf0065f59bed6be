"""Exposures that nobody knows: found from images that tell them, in the gauge that the scene promises."""

from __future__ import annotations

from dataclasses import replace

import torch
from small_fit import SETTINGS, altered

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.steps import Exposures


def test_factors_that_the_images_tell() -> None:
    """Three views of the same light, photographed at 1/2, 1 and 2 of it, each in four pixels."""
    true = torch.tensor([0.5, 1.0, 2.0])
    pixel = torch.arange(12)
    photographs = (0.7 * true)[pixel // 4][:, None].expand(-1, 3)
    exposures = Exposures(3, 4, torch.device("cpu"))
    for step in range(300):
        (exposures.factors(pixel) * 0.7 - photographs).abs().mean().backward()
        exposures.descend(0.02 ** (step / 299))
        assert abs(float(exposures.recovered.log().sum())) < 1e-5
    torch.testing.assert_close(exposures.recovered, true, rtol=0.02, atol=0)


def test_a_gradient_that_is_not_finite_moves_nothing() -> None:
    exposures = Exposures(2, 2, torch.device("cpu"))
    (exposures.factors(torch.arange(4)) * torch.inf).sum().backward()
    exposures.descend(1.0)
    assert exposures.recovered.tolist() == [1, 1]


def test_the_gradient_of_a_step_that_is_skipped_is_forgotten(problem: Problem) -> None:
    parameters = Parameters(altered(problem, scene=replace(problem.scene, exposures_differ=True)), SETTINGS)
    assert parameters.exposures is not None
    parameters.exposures.factors(torch.tensor([0])).sum().backward()
    parameters.clear()  # as the next step begins
    parameters.exposures.descend(1.0)
    assert parameters.exposures.recovered.tolist() == [1] * len(problem.scene.train)
