"""Places of a fit that resemble each other agree more after the step of parsimony, and nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from small_fit import SETTINGS, Found, Record, fit, regularised
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.methods.regularisers import parsimony
from ia_bench.methods.regularisers.fusion import OFFSET
from ia_bench.methods.regularisers.parsimony import CHROMA, GREY, REACH, ROUGHNESS, pooled
from ia_bench.priors.contract import NoPrior
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.color import linear_to_srgb

QUICK = replace(SETTINGS, stage1_steps=8, stage2_steps=4)


def places(count: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    random = torch.Generator().manual_seed(seed)
    return (
        torch.rand(count, 3, generator=random),
        0.03 + 0.97 * torch.rand(count, 1, generator=random),
        torch.randn(count, 3, generator=random),
    )


def test_means_are_those_of_the_formula() -> None:
    """Written with numpy in float64, where all places are partners of each other."""
    colours, roughness, position = places(500)
    albedo = 0.4 + 0.1 * colours
    found = pooled(albedo, roughness, position, torch.Generator().manual_seed(0))
    colour, rough, place = (part.numpy().astype(np.float64) for part in (albedo, roughness, position))
    shown = linear_to_srgb(colour)
    grey = shown @ np.full((3, 1), 3**-0.5)
    square = cdist(grey, grey, "sqeuclidean") / GREY**2
    square += (cdist(shown, shown, "sqeuclidean") - cdist(grey, grey, "sqeuclidean")) / CHROMA**2
    square += cdist(rough, rough, "sqeuclidean") / ROUGHNESS**2
    square += cdist(place, place, "sqeuclidean") / (REACH * np.linalg.norm(np.ptp(place, axis=0))) ** 2
    weights, of_gloss = (np.exp(-power * square / 2) + np.eye(len(colour)) for power in (1, 2))
    weights /= weights.sum(1, keepdims=True)
    of_gloss /= of_gloss.sum(1, keepdims=True)
    assert np.median(weights.max(1)) < 0.9  # places do have partners
    np.testing.assert_allclose(found[0], np.exp(weights @ np.log(colour + OFFSET)) - OFFSET, atol=1e-5)
    np.testing.assert_allclose(found[1], of_gloss @ rough, atol=1e-5)


def test_a_pass_at_the_end_moves_the_material_by_the_share(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parsimony, "PASSES", (1.0,))

    def found(share: float) -> Found:
        return fit(problem, NoPrior(), regularised(QUICK, parsimony={"amount": share}), Record())

    plain, half, whole = (found(share) for share in (0.0, 0.5, 1.0))
    assert torch.equal(whole.light, plain.light)
    inside, surface = problem.gbuffer.coverage() == 1, problem.renderer.surface
    for name in ("albedo", "roughness"):
        shown = [texture_images(surface, problem.gbuffer, getattr(one.material, name))[inside] for one in (plain, half, whole)]
        moved = [float((one - shown[0]).square().mean().sqrt()) for one in shown[1:]]
        assert moved[1] > 1e-3
        assert moved[0] == pytest.approx(0.5 * moved[1], rel=0.1)
        deviations = [float(one.std(0).mean()) for one in shown]
        assert deviations[2] < deviations[0]
