"""What a fit finds does not depend on the unit of the photographs, and pixels that a mask leaves out are no black photograph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Record, altered, fit, losses_of
from torch import Tensor

from ia_bench.methods import photographs
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.start import start_albedo
from ia_bench.priors.none import NoPrior
from ia_bench.scenes.scene import Scene, View

LONGER = replace(SETTINGS, stage1_steps=60, stage2_steps=30, pixels=512)


def exposed(problem: Problem, factor: float) -> Problem:
    """The problem with all photographs multiplied by ``factor``."""
    views = tuple(replace(view, image=view.image * np.float32(factor)) for view in problem.scene.train)
    return altered(problem, scene=replace(problem.scene, train=views))


def eroded(view: View) -> View:
    """The view with a mask that is a pixel too tight on each side, and black outside."""
    inside = view.mask > 0
    kept = inside.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            kept &= np.roll(inside, step, axis)
    return replace(view, image=view.image * kept[..., None], mask=view.mask * kept)


def tight(scene: Scene) -> Scene:
    return replace(scene, train=tuple(map(eroded, scene.train)))


def albedo_of(problem: Problem) -> Tensor:
    return fit(problem, NoPrior(), LONGER, Record()).material.albedo


@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_photographs_of_another_unit_give_the_same_albedo(problem: Problem, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As photographs of the mean that others are brought to; compared as they are, dim ones give another albedo."""
    mean = float(exposed(problem, factor).photographs.radiance[problem.photographs.mask[:, 0] > 0.5].mean())
    usual = exposed(problem, factor * photographs.LEVEL / mean)
    assert usual.photographs.unit == 1
    expected, found = albedo_of(usual), albedo_of(exposed(problem, factor))
    assert float((found - expected).abs().mean()) < 0.02  # roundings differ, and steps enlarge them
    if factor < 1:
        monkeypatch.setattr(photographs, "_unit", lambda inside: 1.0)
        assert float((albedo_of(exposed(problem, factor)) - expected).abs().mean()) > 0.06


def test_usual_photographs_are_compared_as_they_are(problem: Problem) -> None:
    assert problem.photographs.unit == 1
    assert exposed(problem, 0).photographs.unit == 1


def test_pixels_that_are_left_out_pull_nowhere(problem: Problem) -> None:
    """Their photograph is black, and the loss has a gradient in none of them, where the same pixels pull in whole masks."""
    plain = replace(SETTINGS, weights=replace(SETTINGS.weights, smooth_albedo=0, smooth_roughness=0, smooth_light=0))
    cut = altered(problem, scene=tight(problem.scene))
    pixels = torch.nonzero(cut.photographs.left_out)[:, 0]
    assert 100 < len(pixels) < 0.5 * len(cut.photographs.left_out)
    pulls = []
    for one in (problem, cut):
        parameters = Parameters(one, plain)
        losses, _ = losses_of(one, plain)(pixels, parameters, 50, 100, torch.Generator().manual_seed(0))
        sum(losses.values()).backward()
        pulls.append(float(parameters.tensors["albedo"].grad.abs().sum()))
    assert pulls[0] > 0
    assert pulls[1] == 0


def test_a_fit_starts_from_the_colour_of_what_is_not_left_out(problem: Problem) -> None:
    colours = []
    for one in (problem, altered(problem, scene=tight(problem.scene))):
        parameters = Parameters(one, SETTINGS)
        start_albedo(parameters, one, 0.5, None)
        colours.append(parameters.tensors["albedo"][0, 0].detach())
    torch.testing.assert_close(colours[1], colours[0], rtol=0.05, atol=0)
