"""Where a fit starts, and what stays there for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from small_fit import SETTINGS, Record, altered, fit

from ia_bench.light.latlong import SampledLight
from ia_bench.methods.contract import Monitor, PixelSamples, Problem
from ia_bench.methods.two_stage.fit import Fit
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.start import start_albedo
from ia_bench.priors.none import NoPrior


def test_a_prior_that_was_asked_about_views_without_the_mesh_leaves_the_start_to_the_images(problem: Problem) -> None:
    parameters = Parameters(problem, SETTINGS)
    start_albedo(parameters, problem, 0.5, None)
    expected = parameters.tensors["albedo"].detach().clone()
    images = problem.photographs.radiance
    nothing = PixelSamples({"albedo": torch.zeros_like(images)}, torch.zeros_like(images[:, :1]))
    start_albedo(parameters, problem, 0.5, nothing)
    assert torch.equal(parameters.tensors["albedo"], expected)
    assert float(expected.mean()) > 0.1


def test_the_start_explains_the_mean_image(problem: Problem) -> None:
    """With one constant light and albedo; the light is grey, but for the colour that the coat does not have."""
    made = Fit(altered(problem, prior=NoPrior()), SETTINGS, 0, Monitor.silent())
    made._start()
    material, light = made.parameters.recovered(final=True)
    assert torch.equal(light, light[:1, :1].expand(16, 32, 3))
    images = problem.renderer.render_images(problem.gbuffer, material, SampledLight.of(light), 32, torch.Generator().manual_seed(0))
    mean = np.stack([view.image for view in problem.scene.train]).mean((0, 1, 2))
    np.testing.assert_allclose(images["radiance"].numpy().mean((0, 1, 2)), mean, rtol=0.03)
    albedo, grey = material.albedo[0, 0].numpy(), light[0, 0].numpy()
    torch.testing.assert_close(material.albedo, material.albedo[:1, :1].expand_as(material.albedo))
    np.testing.assert_allclose(albedo / albedo.mean(), mean / mean.mean(), rtol=0.001)
    np.testing.assert_allclose(grey / grey.mean(), 1, rtol=0.1)


def test_roughness_waits(problem: Problem) -> None:
    settings, record = replace(SETTINGS, roughness_start=0.5), Record(every=0.0)
    fit(problem, NoPrior(), settings, record)
    states = {step: record.monitor(record.states[step]).load() for step in (15, 16)}
    roughness = [state["parts"]["parameters"]["roughness"] for state in states.values() if state is not None]
    assert bool((roughness[0] == settings.roughness_initial).all())
    assert not torch.equal(*roughness)
