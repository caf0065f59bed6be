"""With `fit.image_loss=dual_buffer` the two halves of a pixel's samples are independent: noise pulls the fit nowhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from means import assert_same_mean
from small_fit import TEXELS_ALONE, Record, altered, fit
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.none import NoPrior
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import PixelRadiance, Renderer

pytestmark = pytest.mark.verify

NOISE, STEPS, PIXELS = 0.5, 400, 512


class NoisyRenderer(Renderer):
    """Shows every pixel the mean of the light, times a log-normal factor of mean 1, independent in every entry."""

    def render_pixels(
        self,
        gbuffer: GBuffer,
        pixels: Tensor,
        material: Material,
        light: SampledLight,
        samples: int,
        generator: torch.Generator,
        **_: object,
    ) -> PixelRadiance:
        noise = torch.exp(NOISE * torch.randn(len(pixels), 1, generator=generator) - NOISE**2 / 2)
        value = light.radiance.mean((0, 1)) * noise
        return PixelRadiance(value, torch.zeros_like(value), torch.full_like(value, 0.5))


def tone_map(radiance: np.ndarray) -> np.ndarray:
    y = np.log1p(radiance)
    return np.where(y <= 0.0031308, 12.92 * y, 1.055 * np.maximum(y, 0.0031308) ** (1 / 2.4) - 0.055)


def slope(radiance: np.ndarray) -> np.ndarray:
    step = 1e-5 * (1 + radiance)
    return (tone_map(radiance + step) - tone_map(np.maximum(radiance - step, 0))) / (step + np.minimum(step, radiance))


def test_gradient_of_a_step_is_that_of_independent_halves(
    problem: Problem, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The optimiser is held still, so that every step asks at the same light m.

    By Gauss-Hermite quadrature in float64: the mean of one half's weight times the mean of the other's slope. The mean of
    their product, which samples in common would give, is many standard errors away.
    """
    gradients: list[Tensor] = []
    lights: list[Tensor] = []

    def held(optimizer: torch.optim.Optimizer) -> None:
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        (log_light,) = (p for p in parameters if p.shape[1] == 2 * p.shape[0])
        gradients.append(log_light.grad.sum((0, 1)))
        lights.append(log_light.detach().exp().mean((0, 1)))

    monkeypatch.setattr(torch.optim.Adam, "step", held)
    settings = FitSettings(stage1_steps=STEPS, stage2_steps=0, pixels=PIXELS, guided=False)
    # The optimisers of other steps have no light of their own to look at.
    settings = replace(settings, rates=replace(settings.rates, scale_ambiguity=0.0), multigrid_rates=TEXELS_ALONE)
    noisy = NoisyRenderer(problem.renderer.surface, problem.renderer.visibility)
    fit(altered(problem, renderer=noisy), NoPrior(), settings, record)
    assert len(gradients) == STEPS
    light = lights[0]
    assert all(torch.equal(light, other) for other in lights)

    images = problem.pixels_of(torch.stack([torch.from_numpy(view.image) for view in problem.scene.train])).double().numpy()
    node, share = np.polynomial.hermite_e.hermegauss(60)
    share = share / share.sum()
    estimate = light.double().numpy() * np.exp(NOISE * node - NOISE**2 / 2)[:, None]  # (K, 3)
    change = slope(estimate) * estimate  # of the tone-mapped estimate with the log radiance of all texels
    weight = np.clip(slope(images) * (estimate[:, None] - images) / settings.residual_cut, -1, 1).mean(1)  # (K, 3)
    scale = settings.weights.image / 3  # the loss is a mean over channels too
    expected = scale * (share @ weight) * (share @ change)
    bias = scale * (share @ (weight * change)) - expected
    found = torch.stack(gradients)
    error = (found.std(0) / STEPS**0.5).numpy()
    assert (np.abs(bias) > 10 * error).all()
    # Around a gradient that is almost none, the bias is the scale: it is added to both sides.
    assert_same_mean(found.numpy() + bias, (expected + bias)[None], resolution=0.1)
