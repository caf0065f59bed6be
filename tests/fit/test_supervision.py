"""What reaches the loss of a prior's samples: the right pixels, aligned when due, compared in the prior's encoding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.fit.problem import Problem
from ia_bench.fit.supervision import ALIGNMENT_PERIOD, Supervision, draw_targets
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.color import linear_to_srgb


class Spy:
    """Returns what it was told to, and remembers how it was asked."""

    provides = frozenset({"albedo", "specular"})
    encoding: Mapping[str, str] = {"albedo": "srgb", "specular": "srgb"}

    def __init__(self, **answers: object) -> None:
        self.answers = answers
        self.asked: dict = {}

    def sample(self, images: Tensor, masks: Tensor, **rest: object) -> dict:
        self.asked = {"images": images, "masks": masks, **rest}
        samples = {"albedo": 0.5 * images, "specular": 2 * images, **self.answers}
        return {name: value for name, value in samples.items() if value is not None}


@pytest.fixture(scope="module")
def texture() -> Tensor:
    return 0.2 + 0.6 * torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))


def seen(problem: Problem, texture: Tensor) -> Tensor:
    """The texture's albedo in every training pixel, through the renderer's own pictures: (P, 3)."""
    return problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, texture))


def test_targets_are_the_samples_of_the_training_pixels(problem: Problem) -> None:
    spy = Spy()
    targets = draw_targets(problem, spy, seed=7, guidance=None)
    assert spy.asked["seed"] == 7
    assert spy.asked["guidance"] is None
    view, row, column = np.unravel_index(int(problem.gbuffer.pixel[100]), problem.gbuffer.shape)
    expected = problem.scene.train[view].image[row, column]
    np.testing.assert_array_equal(targets["albedo"][100], 0.5 * expected)
    np.testing.assert_array_equal(targets["specular"][100], 2 * expected)
    np.testing.assert_array_equal(spy.asked["masks"], np.stack([v.mask for v in problem.scene.train]))


def test_guidance_reaches_the_prior_as_images(problem: Problem, texture: Tensor) -> None:
    spy = Spy()
    pixels = seen(problem, texture)
    draw_targets(problem, spy, seed=0, guidance={"albedo": pixels})
    image = spy.asked["guidance"]["albedo"]
    assert torch.equal(image, texture_images(problem.renderer.surface, problem.gbuffer, texture))
    assert torch.equal(problem.pixels_of(image), pixels)
    outside = torch.ones(problem.gbuffer.shape).flatten()
    outside[problem.gbuffer.pixel] = 0
    assert float((image.sum(-1).flatten() * outside).abs().max()) == 0


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"specular": None}, r"provides \['albedo', 'specular'\] but sampled \['albedo'\]"),
        ({"normal": torch.zeros(1)}, r"but sampled \['albedo', 'normal', 'specular'\]"),
        ({"albedo": torch.zeros(16, 32, 32, 1)}, r"albedo has shape \(16, 32, 32, 1\), expected \(16, 32, 32, 3\)"),
        ({"specular": torch.full((16, 32, 32, 3), torch.nan)}, "specular has NaN or Inf in 49152 values"),
    ],
)
def test_broken_samples_are_refused(problem: Problem, answers: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        draw_targets(problem, Spy(**answers), seed=0, guidance=None)


def test_alignment_is_found_from_the_texture(problem: Problem, texture: Tensor) -> None:
    """The estimate must see the same pixels as the renderer: half the albedo as target gives the scale 1/2 exactly."""
    pixels = seen(problem, texture)
    for mode in ("scale", "scale_shift"):
        supervision = Supervision(problem, Spy(), mode, {"albedo": 0.5 * pixels})
        supervision.update(texture, 0)
        state = supervision.alignment_state()
        torch.testing.assert_close(state["scale"], torch.full((16,), 0.5), rtol=1e-4, atol=0)
        torch.testing.assert_close(state["shift"], torch.zeros(16), rtol=0, atol=1e-5)
        every = torch.arange(len(pixels))
        assert float(supervision.albedo_loss(pixels, every)) < 1e-4
        assert float(supervision.albedo_loss(pixels * torch.tensor([1.2, 1.0, 0.8]), every)) > 0.01


def test_loss_is_the_mean_difference_in_the_priors_encoding(problem: Problem, texture: Tensor) -> None:
    pixels, chosen = seen(problem, texture), torch.tensor([3, 50, 700])
    target = pixels.flip(0)
    for encoding in ("linear", "srgb"):
        spy = Spy()
        spy.encoding = {"albedo": encoding, "specular": "srgb"}
        supervision = Supervision(problem, spy, "none", {"albedo": target})
        supervision.update(texture, 0)
        encode = linear_to_srgb if encoding == "srgb" else np.asarray
        expected = np.abs(encode(pixels[chosen].double().numpy()) - encode(target[chosen].double().numpy())).mean()
        assert float(supervision.albedo_loss(pixels[chosen], chosen)) == pytest.approx(expected, rel=1e-4)


def test_alignment_is_estimated_when_due(problem: Problem, texture: Tensor) -> None:
    supervision = Supervision(problem, Spy(), "scale", {"albedo": seen(problem, texture)})
    scales = []
    for step in range(2 * ALIGNMENT_PERIOD + 1):
        supervision.update(texture * (1 - 0.01 * step), step)
        scales.append(float(supervision.alignment_state()["scale"][0]))
    changes = [step for step in range(1, len(scales)) if scales[step] != scales[step - 1]]
    assert changes == [ALIGNMENT_PERIOD, 2 * ALIGNMENT_PERIOD]
    resumed = Supervision(problem, Spy(), "scale", supervision.targets)
    resumed.restore_alignment(supervision.alignment_state())
    resumed.update(texture, 2 * ALIGNMENT_PERIOD + 1)  # not due, so the restored one stays
    assert float(resumed.alignment_state()["scale"][0]) == scales[-1]
    resumed.restore_alignment({})
    assert resumed.alignment_state() == {}


def test_specular_loss_sees_highlights_and_the_dark(problem: Problem) -> None:
    count = len(problem.gbuffer.pixel)
    supervision = Supervision(problem, Spy(), "none", {"specular": torch.full((count, 3), 0.2)})
    chosen = torch.arange(10)
    assert float(supervision.specular_loss(torch.full((10, 3), 0.2), chosen)) == 0
    assert float(supervision.specular_loss(torch.full((10, 3), 0.3), chosen)) > 0.01
    assert float(supervision.specular_loss(torch.full((10, 3), 1e5), chosen)) < 10
    supervision.update(torch.zeros(4, 4, 3), 0)  # nothing to align without an albedo
    assert supervision.alignment_state() == {}


def test_prior_is_shown_the_training_images_alone(problem: Problem) -> None:
    blind = replace(problem, scene=problem.scene.for_training())
    spy = Spy()
    draw_targets(blind, spy, seed=0, guidance=None)
    np.testing.assert_array_equal(spy.asked["images"], np.stack([v.image for v in problem.scene.train]))
