"""Gradients of the whole renderer without bias, and the bias of a squared loss whose two factors share their samples.

Gradients against finite differences with the samples held, and against quadrature: test_estimator.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
import torch.autograd.forward_ad as fwAD
from means import assert_same_mean
from stage import Stage
from torch import Tensor

from ia_bench.light.latlong import SampledLight, resize_light
from ia_bench.material.textures import Material

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
    light = torch.from_numpy(resize_light(soft_light.numpy(), 8)).clamp_min(1e-3).log()
    return {"albedo": albedo, "roughness": roughness, "log_light": light}


@pytest.fixture(scope="module")
def estimate(tiny_stage: Stage) -> Estimate:
    """Independent estimates (repeats, P, 3) of a few pixels; light, tables and directions are made anew, as a fit does it."""
    chosen = torch.randperm(len(tiny_stage.gbuffer.pixel), generator=torch.Generator().manual_seed(0))[:PIXELS]
    points = tiny_stage.points(chosen)
    chosen = chosen[(points.normal * points.view).sum(-1) > 0.1]

    def run(leaves: Leaves, seed: int, *, samples: int = SAMPLES, repeats: int = REPEATS) -> Tensor:
        light = SampledLight.of(leaves["log_light"].exp(), uniform_fraction=0.1)
        material = Material(leaves["albedo"], leaves["roughness"])
        drawn = tiny_stage.renderer().render_pixels(
            tiny_stage.gbuffer, chosen.repeat(repeats), material, light, samples, torch.Generator().manual_seed(seed)
        )
        return drawn.radiance.reshape(repeats, len(chosen), 3)

    return run


def moves(leaf: Tensor) -> tuple[Tensor, Tensor]:
    """Two directions of change: everywhere the same, and random signs that are constant on a quarter along each axis."""
    signs = torch.randint(2, (4, 4, leaf.shape[2]), generator=torch.Generator().manual_seed(4)) * 2.0 - 1
    return torch.ones_like(leaf), signs.repeat_interleave(len(leaf) // 4, 0).repeat_interleave(leaf.shape[1] // 4, 1)


@torch.no_grad()
def with_slopes(estimate: Estimate, leaves: Leaves, name: str, move: Tensor, seed: int, **size: int) -> tuple[Tensor, Tensor]:
    """Estimates and their slopes along a direction of change, by forward differentiation."""
    with fwAD.dual_level():
        dual = fwAD.unpack_dual(estimate({**leaves, name: fwAD.make_dual(leaves[name], move)}, seed, **size))
        return dual.primal, dual.tangent


@pytest.mark.parametrize("name", STEPS)
def test_gradient_is_unbiased(leaves: Leaves, estimate: Estimate, name: str) -> None:
    """t-test of the gradient's mean against central differences of the estimate itself, along two directions.

    Both ends of a difference have the same random numbers, so their directions, densities, shadows and texels move with the
    parameter: all that the gradient, which holds them still, leaves out. The pixels are weighted at random. Forward
    differentiation gives the gradient of each repeat; their sum is that of backward differentiation, which the fit uses.
    """
    step, found, expected, summed = STEPS[name], [], [], []
    proxy = torch.rand(estimate(leaves, 0, repeats=1).shape, generator=torch.Generator().manual_seed(5))
    for move in moves(leaves[name]):
        slopes = (with_slopes(estimate, leaves, name, move, 1)[1] * proxy).double().sum((1, 2))
        with torch.no_grad():
            high, low = (estimate({**leaves, name: leaves[name] + sign * step * move}, 2) for sign in (1, -1))
        found.append(slopes)
        expected.append(((high - low) * proxy).double().sum((1, 2)) / (2 * step))
        leaf = leaves[name].clone().requires_grad_()
        (gradient,) = torch.autograd.grad((estimate({**leaves, name: leaf}, 1) * proxy).sum(), leaf)
        summed.append(float((gradient * move).sum()))
        error = float(expected[-1].std()) / math.sqrt(REPEATS)
        assert summed[-1] == pytest.approx(float(slopes.sum()), rel=1e-3, abs=1e-3 * error * REPEATS)
    assert_same_mean(torch.stack(found, 1).numpy(), torch.stack(expected, 1).numpy(), resolution=0.05)


@pytest.mark.parametrize("name", ["albedo", "log_light"])
def test_squared_loss_is_biased_by_shared_samples_alone(leaves: Leaves, estimate: Estimate, name: str) -> None:
    """Shared samples add 2 Cov(I, dI) to the gradient of (I - y)^2, seen at 10 sigma; with a second estimate nothing is added.

    y is 3 % off the mean, near the end of a fit. The gradient without noise, and the covariance, come from other draws than
    the two kinds of gradient. That the fit takes two estimates: tests/fit/test_crossed_loss.py.
    """
    size = {"samples": 8, "repeats": 600}
    move = moves(leaves[name])[0]
    (value, slope), (second, _), (third, third_slope) = (
        [part.double().numpy() for part in with_slopes(estimate, leaves, name, move, seed, **size)] for seed in (6, 7, 8)
    )
    target = 1.03 * value.mean(0)
    shared = (2 * (value - target) * slope).mean((1, 2))
    independent = (2 * (second - target) * slope).mean((1, 2))
    fourth = np.roll(third, 1, 0)  # the estimate of another repeat
    without_noise = (2 * (fourth - target) * third_slope).mean((1, 2))
    covariance = (2 * (third - fourth) * third_slope).mean((1, 2))
    assert covariance.mean() > 10 * covariance.std() / math.sqrt(len(covariance))
    assert covariance.mean() > 0.5 * abs(without_noise.mean())
    assert_same_mean(independent[:, None], without_noise[:, None], resolution=0.2)
    assert_same_mean(shared[:, None], (without_noise + covariance)[:, None], resolution=0.2)
