"""Pixels known from below only: brighter renders cost nothing and have no gradient, darker ones cost what they always did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ia_bench.methods.photographs import known_pixels, one_sided
from ia_bench.methods.two_stage.losses import dual_buffer_loss
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.scenes.scene import Scene
from tests.methods.small_fit import SETTINGS, losses_of, make_problem

CLIP = torch.full((3, 3), 0.5)
KNOWN = torch.tensor([[True], [False], [False]])
BRIGHTER, DARKER = 0.8, 0.2


def gradients(value: torch.Tensor, of: torch.Tensor) -> torch.Tensor:
    return torch.autograd.grad(value, of)[0].abs().sum(1)


def test_views_that_know_every_pixel_ask_for_nothing(tiny: Scene) -> None:
    assert known_pixels(tiny.train) is None
    valid = np.zeros((32, 32), bool)
    known = known_pixels([replace(tiny.train[0], valid=valid), tiny.train[1]])
    assert known is not None
    assert known.shape == (2, 32, 32, 1)
    assert not known[0].any()
    assert known[1].all()


def test_one_sided_targets() -> None:
    rendered = torch.tensor([[BRIGHTER] * 3, [BRIGHTER] * 3, [DARKER] * 3], requires_grad=True)
    error = (rendered - one_sided(CLIP, rendered, KNOWN)).abs()
    torch.testing.assert_close(error.detach()[:, 0], torch.tensor([0.3, 0.0, 0.3]))
    torch.testing.assert_close(gradients(error.sum(), rendered), torch.tensor([3.0, 0.0, 3.0]))


def test_the_crossed_loss_is_one_sided_in_both_halves() -> None:
    first = torch.tensor([[BRIGHTER] * 3, [BRIGHTER] * 3, [DARKER] * 3], requires_grad=True)
    second = first.detach().clone().requires_grad_(True)
    one_sidedly, as_ever = (dual_buffer_loss(first, second, CLIP, 0.1, known) for known in (KNOWN, None))
    for half in (first, second):
        given, usual = (gradients(loss, half) for loss in (one_sidedly, as_ever))
        assert usual.min() > 0
        assert given.tolist() == [usual[0], 0, usual[2]]
        one_sidedly, as_ever = (dual_buffer_loss(first, second, CLIP, 0.1, known) for known in (KNOWN, None))


def test_a_loss_of_unknown_pixels_pulls_nothing(tiny: Scene) -> None:
    """Black and unknown everywhere: no render is too bright. Known and black: every texture and the light are pulled down."""
    found = {}
    for known in (True, False):
        valid = np.full((32, 32), known)
        black = replace(tiny, train=tuple(replace(v, image=0 * v.image, valid=valid) for v in tiny.train))
        problem = make_problem(black.blind())
        settings = replace(SETTINGS, weights=replace(SETTINGS.weights, smooth_albedo=0, smooth_roughness=0, smooth_light=0))
        parameters, generator = Parameters(problem, settings), torch.Generator().manual_seed(0)
        losses, _ = losses_of(problem, settings)(torch.arange(200), parameters, 50, 100, generator)
        sum(losses.values()).backward()
        found[known] = float(parameters.tensors["log_light"].grad.abs().sum()), float(parameters.tensors["albedo"].grad.abs().sum())
    assert min(found[True]) > 0
    assert found[False] == (0, 0)
