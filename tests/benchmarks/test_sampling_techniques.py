"""Every technique of the work-precision diagrams estimates what the renderer estimates; only its noise differs."""

import math

import numpy as np
import pytest
import torch

from benchmarks.work_precision.forward import WAYS, ForwardStage
from ia_bench.light.latlong import SampledLight
from ia_bench.render.renderer import Renderer

PARTS, SAMPLES, TRUE_SAMPLES = 16, 64, 256
BIAS = 0.1  # relative, that every test must be able to see
FALSE_ALARM = 1e-3  # of the whole file, shared by its z-tests


@pytest.fixture(scope="module")
def stage() -> ForwardStage:
    """A view of `tiny`, its materials at least 0.4 rough and under a light without a sun, so that any technique converges."""
    stage = ForwardStage("tiny")
    stage.material.roughness.clamp_(min=0.4)
    rows = torch.linspace(0.2, 2, 16)[:, None, None]
    columns = 1 + 0.5 * torch.sin(torch.arange(32) * (2 * math.pi / 32))[None, :, None]
    stage.light = SampledLight.of(rows * columns * torch.tensor([1.0, 0.8, 0.6]))
    return stage


def means(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance of (R, H, W, 3) images in a 2 x 2 grid of the view, (4, 3), and its standard error."""
    half = images.shape[1] // 2
    cells = images.astype(np.float64).reshape(len(images), 2, half, 2, half, 3).mean((2, 4)).reshape(len(images), 4, 3)
    return cells.mean(0), cells.std(0, ddof=1) / math.sqrt(len(images))


@pytest.fixture(scope="module")
def truth(stage: ForwardStage) -> tuple[np.ndarray, np.ndarray]:
    renderer = Renderer(stage.surface, stage.rays)
    every, images = torch.arange(len(stage.gbuffer.pixel)), torch.zeros(PARTS, *stage.gbuffer.shape[1:], 3)
    for part, image in enumerate(images):
        generator = torch.Generator().manual_seed(part)
        rendered = renderer.render_pixels(stage.gbuffer, every, stage.material, stage.light, TRUE_SAMPLES, generator)
        image.reshape(-1, 3)[stage.gbuffer.pixel] = rendered.radiance
    return means(images.numpy())


@pytest.mark.parametrize("name", WAYS)
def test_a_technique_has_the_renderers_mean(stage: ForwardStage, truth: tuple[np.ndarray, np.ndarray], name: str):
    """Largest z of four quarters of the view and three channels, t-distributed, Sidak."""
    from scipy.stats import t

    images = np.stack([stage.estimate(WAYS[name], SAMPLES, 10_000 + seed) for seed in range(PARTS)])
    mean, error = means(images)
    z = np.abs(mean - truth[0]) / np.sqrt(error**2 + truth[1] ** 2)
    tests = z.size * len(WAYS)
    limit = t.isf((1 - (1 - FALSE_ALARM) ** (1 / tests)) / 2, PARTS - 1)
    assert z.max() < limit, f"{name}: {mean.mean():.5f} against {truth[0].mean():.5f}, z = {z.max():.2f}, limit {limit:.2f}"
    assert (BIAS * mean / error).max() > 2 * limit, f"so noisy that a bias of {BIAS} would not be found"
