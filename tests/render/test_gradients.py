"""Gradients of the whole renderer without bias, and the bias of a squared loss whose two factors share their samples.

Gradients against finite differences with the samples held, and against quadrature: test_detached_gradients.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from means import assert_same_mean
from stage import Stage
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.renderer import Renderer

pytestmark = [
    pytest.mark.verify,
    pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated"),  # inside torch's forward differentiation
]

PIXELS, SAMPLES, REPEATS = 60, 32, 300
STEPS = {"albedo": 0.05, "roughness": 0.05, "log_light": 0.1}  # of central differences; their error is below the noise

Leaves = dict[str, Tensor]
Estimate = Callable[..., Tensor]


@pytest.fixture(scope="module")
def leaves(tiny_material: Material, soft_light: Tensor) -> Leaves:
    """The parameters of a fit; the textures coarse, so that every texel is seen."""
    pool = torch.nn.functional.adaptive_avg_pool2d
    albedo, roughness = (
        pool(texture.permute(2, 0, 1), 4).permute(1, 2, 0).contiguous()
        for texture in (tiny_material.albedo, tiny_material.roughness)
    )
    light = LatLongEnvironment(soft_light).latlong(8).clamp_min(1e-3).log()
    return {"albedo": albedo, "roughness": roughness, "log_light": light}


@pytest.fixture(scope="module")
def estimate(tiny_stage: Stage) -> Estimate:
    """Independent estimates (repeats, P, 3) of a few pixels; light, tables and directions are made anew, as a fit does it."""
    chosen = torch.randperm(len(tiny_stage.gbuffer.pixel), generator=torch.Generator().manual_seed(0))[:PIXELS]
    points = tiny_stage.points(chosen)
    chosen = chosen[(points.normal * points.view).sum(-1) > 0.1]

    def same(renderer: Renderer) -> Renderer:
        return renderer

    def run(
        leaves: Leaves, seed: int, *, samples: int = SAMPLES, repeats: int = REPEATS, by: Callable[[Renderer], Renderer] = same
    ) -> Tensor:
        light = SampledLight.of(leaves["log_light"].exp(), uniform_fraction=0.1)
        material = Material(leaves["albedo"], leaves["roughness"])
        drawn = by(tiny_stage.renderer()).render_pixels(
            tiny_stage.gbuffer, chosen.repeat(repeats), material, light, samples, torch.Generator().manual_seed(seed)
        )
        return drawn.radiance.reshape(repeats, len(chosen), 3)

    return run


def moves(leaf: Tensor) -> tuple[Tensor, Tensor]:
    """Two directions of change: everywhere the same, and random signs that are constant on a quarter along each axis."""
    signs = torch.randint(2, (4, 4, leaf.shape[2]), generator=torch.Generator().manual_seed(4)) * 2.0 - 1
    return torch.ones_like(leaf), signs.repeat_interleave(len(leaf) // 4, 0).repeat_interleave(leaf.shape[1] // 4, 1)


def slopes(
    estimate: Estimate, leaves: Leaves, name: str, move: Tensor, seed: int, towards: Callable[[int, Tensor], Tensor], **size: int
) -> tuple[Tensor, Tensor]:
    """Estimates (R, P, 3), and how <estimate, ``towards`` (repeat, estimate)> of each grows along ``move``, (R,) float64.

    By backward differentiation, as the fit has it, of one repeat after another; the weights are held still.
    """
    repeats = size.pop("repeats", REPEATS)
    found, grown = [], []
    for repeat in range(repeats):
        leaf = leaves[name].clone().requires_grad_()
        (value,) = estimate({**leaves, name: leaf}, 100_000 * seed + repeat, repeats=1, **size)
        (gradient,) = torch.autograd.grad((value * towards(repeat, value.detach())).sum(), leaf)
        found.append(value.detach())
        grown.append((gradient * move).double().sum())
    return torch.stack(found), torch.stack(grown)


@pytest.mark.parametrize("name", STEPS)
def test_gradient_is_unbiased(leaves: Leaves, estimate: Estimate, name: str) -> None:
    """t-test of the gradient's mean against central differences of the estimate itself, along two directions.

    Both ends of a difference have the same random numbers, so their directions, densities, shadows and texels move with the
    parameter: all that the gradient, which holds them still, leaves out. The pixels are weighted at random. The gradient of
    the sum over all repeats is the sum of theirs.
    """
    step, found, expected = STEPS[name], [], []
    proxy = torch.rand(estimate(leaves, 0, repeats=1)[0].shape, generator=torch.Generator().manual_seed(5))
    for move in moves(leaves[name]):
        found.append(slopes(estimate, leaves, name, move, 1, lambda *_: proxy)[1])
        with torch.no_grad():
            high, low = (estimate({**leaves, name: leaves[name] + sign * step * move}, 2) for sign in (1, -1))
        expected.append(((high - low) * proxy).double().sum((1, 2)) / (2 * step))
    assert_same_mean(torch.stack(found, 1).numpy(), torch.stack(expected, 1).numpy(), resolution=0.05)


def test_squared_loss_is_biased_by_shared_samples_alone(leaves: Leaves, estimate: Estimate) -> None:
    """Shared samples add 2 Cov(I, dI) to the gradient of (I - y)^2, seen at 10 sigma; with a second estimate nothing is added.

    y is 3 % off the mean, near the end of a fit. The gradient without noise, and the covariance, come from other draws than
    the two kinds of gradient. That the fit takes two estimates: tests/fit/test_crossed_loss.py.
    """
    name, size = "albedo", {"samples": 8, "repeats": 600}
    move = moves(leaves[name])[0]
    with torch.no_grad():
        value, second, third = (estimate(leaves, seed, **size) for seed in (6, 7, 8))
    target, fourth = 1.03 * value.double().mean(0).float(), value  # of other draws than those of the gradients
    weight = 2 / value[0].numel()

    def slope(towards: Callable[[int, Tensor], Tensor], seed: int) -> np.ndarray:
        return slopes(estimate, leaves, name, move, seed, towards, **size)[1].numpy()

    shared = slope(lambda _, own: weight * (own - target), 9)
    independent = slope(lambda repeat, _: weight * (second[repeat] - target), 9)
    without_noise = slope(lambda repeat, _: weight * (fourth[repeat] - target), 10)
    covariance = slope(lambda repeat, own: weight * (own - third[repeat]), 10)
    assert covariance.mean() > 10 * covariance.std() / math.sqrt(len(covariance))
    assert covariance.mean() > 0.5 * abs(without_noise.mean())
    assert_same_mean(independent[:, None], without_noise[:, None], resolution=0.2)
    assert_same_mean(shared[:, None], (without_noise + covariance)[:, None], resolution=0.2)
