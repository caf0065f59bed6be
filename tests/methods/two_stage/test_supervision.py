"""What reaches the loss of a prior's targets: the right pixels, aligned when due, compared in the prior's encoding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import altered
from torch import Tensor

from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.supervision import ALIGNMENT_PERIOD, Supervision
from ia_bench.methods.two_stage.targets import Targets
from ia_bench.priors.contract import PriorInfo
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.color import linear_to_srgb


class Encoded:
    """All that a supervision reads of a prior."""

    info = PriorInfo(frozenset({"albedo", "specular"}))


@pytest.fixture(scope="module")
def texture() -> Tensor:
    return 0.2 + 0.6 * torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))


def seen(problem: Problem, texture: Tensor) -> Tensor:
    """The texture's albedo in every training pixel, through the renderer's own pictures: (P, 3)."""
    return problem.pixels_of(texture_images(problem.renderer.surface, problem.gbuffer, texture))


def even(values: dict[str, Tensor]) -> Targets:
    """Targets of equal weight everywhere."""
    return Targets(values, torch.ones(len(next(iter(values.values()))), 1))


def supervise(problem: Problem, ssi: str, targets: Targets, **settings: object) -> Supervision:
    changed = altered(problem, supervision=SupervisionSettings(**settings))  # type: ignore[arg-type]
    return Supervision(changed, Encoded(), ssi, targets)  # type: ignore[arg-type]


def albedo_loss(supervision: Supervision, prediction: Tensor, pixels: Tensor, texture: Tensor) -> float:
    return float(supervision.albedo_loss(prediction, pixels, texture, torch.Generator().manual_seed(0)))


def test_alignment_is_found_from_the_texture(problem: Problem, texture: Tensor) -> None:
    """The estimate must see the same pixels as the renderer: half the albedo as target gives the scale 1/2 exactly."""
    pixels = seen(problem, texture)
    for mode in ("scale", "scale_shift"):
        supervision = supervise(problem, mode, even({"albedo": 0.5 * pixels}))
        supervision.update(texture, 0)
        state = supervision.alignment()
        torch.testing.assert_close(state["scale"], torch.full((16,), 0.5), rtol=1e-4, atol=0)
        torch.testing.assert_close(state["shift"], torch.zeros(16), rtol=0, atol=1e-5)
        every = torch.arange(len(pixels))
        assert albedo_loss(supervision, pixels, every, texture) < 1e-4
        assert albedo_loss(supervision, pixels * torch.tensor([1.2, 1.0, 0.8]), every, texture) > 0.01


def test_loss_is_the_weighted_mean_difference_in_the_priors_encoding(problem: Problem, texture: Tensor) -> None:
    pixels, chosen = seen(problem, texture), torch.tensor([3, 50, 700])
    target = pixels.flip(0)
    weight = torch.rand(len(pixels), 1, generator=torch.Generator().manual_seed(1))
    for encoding in ("linear", "srgb"):
        prior = Encoded()
        prior.info = PriorInfo(frozenset({"albedo", "specular"}), encoding={"albedo": encoding, "specular": "srgb"})
        supervision = Supervision(problem, prior, "none", Targets({"albedo": target}, weight))  # type: ignore[arg-type]
        supervision.update(texture, 0)
        encode = linear_to_srgb if encoding == "srgb" else np.asarray
        differences = np.abs(encode(pixels[chosen].double().numpy()) - encode(target[chosen].double().numpy()))
        expected = (weight[chosen].double().numpy() * differences).mean()
        assert albedo_loss(supervision, pixels[chosen], chosen, texture) == pytest.approx(expected, rel=1e-4)


def test_terms_are_weighed(problem: Problem, texture: Tensor) -> None:
    pixels = seen(problem, texture)
    targets, every = even({"albedo": pixels.flip(0)}), torch.arange(len(pixels))

    def loss(**settings: object) -> float:
        supervision = supervise(problem, "scale", targets, **settings)
        supervision.update(texture, 0)
        return albedo_loss(supervision, pixels, every, texture)

    for kind, weight in (("target", "target_weight"), ("similarity", "kernel_weight")):
        one = loss(kind=kind, **{weight: 1.0})
        assert one > 0
        assert loss(kind=kind, **{weight: 0.5}) == pytest.approx(0.5 * one, rel=1e-5)


def test_the_specular_term_is_weighed(problem: Problem) -> None:
    every = torch.arange(len(problem.gbuffer.pixel))
    radiance = torch.rand(len(every), 3, generator=torch.Generator().manual_seed(0))
    full, tenth = (
        float(supervise(problem, "scale", even({"specular": radiance.flip(0)}), specular_weight=w).specular_loss(radiance, every))
        for w in (1.0, 0.1)
    )
    assert tenth == pytest.approx(0.1 * full, rel=1e-5)


def test_distilled_loss_is_half_the_square_and_needs_no_alignment(problem: Problem, texture: Tensor) -> None:
    pixels, every = seen(problem, texture), torch.arange(len(seen(problem, texture)))
    targets = even({"albedo": 0.5 * pixels, "specular": 0.25 * pixels})
    supervision = supervise(problem, "scale", targets, kind="sds")
    supervision.update(texture, 0)
    assert supervision.alignment() == {}
    expected = linear_to_srgb(pixels.double().numpy()) - linear_to_srgb(0.5 * pixels.double().numpy())
    assert albedo_loss(supervision, pixels, every, texture) == pytest.approx(0.5 * (expected**2).mean(), rel=1e-4)
    expected = linear_to_srgb(pixels.double().numpy()) - linear_to_srgb(0.25 * pixels.double().numpy())
    assert float(supervision.specular_loss(pixels, every)) == pytest.approx(0.5 * (expected**2).mean(), rel=1e-4)


def test_alignment_is_estimated_when_due(problem: Problem, texture: Tensor) -> None:
    supervision = supervise(problem, "scale", even({"albedo": seen(problem, texture)}))
    scales = []
    for step in range(2 * ALIGNMENT_PERIOD + 1):
        supervision.update(texture * (1 - 0.01 * step), step)
        scales.append(float(supervision.alignment()["scale"][0]))
    changes = [step for step in range(1, len(scales)) if scales[step] != scales[step - 1]]
    assert changes == [ALIGNMENT_PERIOD, 2 * ALIGNMENT_PERIOD]
    resumed = supervise(problem, "scale", Targets(**supervision.targets.state()))
    resumed.restore_alignment(supervision.alignment())
    resumed.update(texture, 2 * ALIGNMENT_PERIOD + 1)  # not due, so the restored one stays
    assert float(resumed.alignment()["scale"][0]) == scales[-1]
    resumed.restore_alignment({})
    assert resumed.alignment() == {}


def test_views_that_were_not_asked_have_no_say(problem: Problem, texture: Tensor) -> None:
    pixels = seen(problem, texture)
    asked = problem.gbuffer.pixel < 4 * problem.gbuffer.shape[1] * problem.gbuffer.shape[2]
    values = torch.where(asked[:, None], 0.5 * pixels, 0.0)
    targets = Targets({"albedo": values}, asked.float()[:, None] / asked.float().mean())
    for kind in ("target", "similarity"):
        supervision = supervise(problem, "scale", targets, kind=kind)
        supervision.update(texture, 0)
        others = torch.nonzero(~asked)[:, 0]
        assert albedo_loss(supervision, pixels[others], others, texture) == 0
    supervision = supervise(problem, "scale", targets)
    supervision.update(texture, 0)
    assert albedo_loss(supervision, pixels, torch.arange(len(pixels)), texture) < 1e-4


def test_specular_loss_sees_highlights_and_the_dark(problem: Problem) -> None:
    count = len(problem.gbuffer.pixel)
    supervision = supervise(problem, "none", even({"specular": torch.full((count, 3), 0.2)}), kind="similarity")
    chosen = torch.arange(10)
    assert float(supervision.specular_loss(torch.full((10, 3), 0.2), chosen)) == 0
    assert float(supervision.specular_loss(torch.full((10, 3), 0.3), chosen)) > 0.01
    assert float(supervision.specular_loss(torch.full((10, 3), 1e5), chosen)) < 10
    supervision.update(torch.zeros(4, 4, 3), 0)  # nothing to align without an albedo
    assert supervision.alignment() == {}


def test_a_target_at_its_ceiling_asks_only_for_at_least_as_much(problem: Problem) -> None:
    every = torch.arange(len(problem.gbuffer.pixel))
    radiance = torch.full((len(every), 3), 0.5)
    clipped = torch.arange(len(every)) % 2 == 0
    targets = replace(even({"specular": radiance}), at_least={"specular": clipped[:, None]})
    supervision = supervise(problem, "none", targets)

    def loss(factor: float, chosen: Tensor) -> float:
        return float(supervision.specular_loss(factor * radiance[chosen], every[chosen]))

    assert loss(2, clipped) == 0
    assert loss(2, ~clipped) > 0.01
    assert loss(0.5, clipped) == pytest.approx(loss(0.5, ~clipped), rel=1e-5)
