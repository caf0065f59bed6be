"""With `fit.image_loss=squared` the gradient of a step has no bias, however noisy the renders are.

What samples shared by the residual and the gradient would add is measured in tests/render/test_gradients.py.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from means import assert_same_mean
from small_fit import Record, fit
from torch import Tensor

from ia_bench.fit.problem import Problem
from ia_bench.fit.settings import FitSettings
from ia_bench.material.textures import Material
from ia_bench.priors.none import NoPrior
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import Light, PixelRadiance, Renderer

pytestmark = pytest.mark.verify

NOISE, STEPS, PIXELS = 1.0, 400, 512


class NoisyRenderer(Renderer):
    """Shows every pixel the mean of the light, times 1 + NOISE e with e normal and independent in every call."""

    def render_pixels(
        self,
        gbuffer: GBuffer,
        pixels: Tensor,
        material: Material,
        light: Light,
        samples: int,
        generator: torch.Generator,
        **_: object,
    ) -> PixelRadiance:
        value = light.radiance.mean((0, 1)) * (1 + NOISE * torch.randn(len(pixels), 1, generator=generator))
        return PixelRadiance(value, torch.zeros_like(value), torch.full_like(value, 0.5))


def test_gradient_of_the_squared_loss_is_unbiased_in_the_fit(
    problem: Problem, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The optimiser is held still, so that every step asks at the same light m: the mean gradient is 2 (m - y) m by channel.

    One estimate for both factors would add 2 NOISE^2 m^2, which is many times as much.
    """
    gradients: list[Tensor] = []
    lights: list[Tensor] = []

    def held(optimizer: torch.optim.Optimizer) -> None:
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        (log_light,) = (p for p in parameters if p.shape[1] == 2 * p.shape[0])
        gradients.append(log_light.grad.sum((0, 1)))
        lights.append(log_light.detach().exp().mean((0, 1)))

    monkeypatch.setattr(torch.optim.Adam, "step", held)
    settings = FitSettings(image_loss="squared", stage1_steps=STEPS, stage2_steps=0, pixels=PIXELS, guided=False)
    settings = replace(settings, rates=replace(settings.rates, cast=0.0))  # its optimiser has no light of its own to look at
    noisy = NoisyRenderer(problem.renderer.surface, problem.renderer.visibility)
    fit(replace(problem, renderer=noisy), NoPrior(), settings, record)
    assert len(gradients) == STEPS
    light = lights[0]
    assert all(torch.equal(light, other) for other in lights)

    images = problem.pixels_of(torch.stack([torch.from_numpy(view.image) for view in problem.scene.train]))
    expected = settings.weights.image * 2 * (light - images.mean(0)) * light / 3  # the loss is a mean over channels too
    bias = settings.weights.image * 2 * NOISE**2 * light**2 / 3
    found = torch.stack(gradients)
    error = found.std(0) / STEPS**0.5
    assert (bias > 10 * error).all()
    # Around a gradient that is almost none, the bias is the scale: it is added to both sides.
    assert_same_mean((found + bias).numpy(), (expected + bias)[None].numpy(), resolution=0.1)
