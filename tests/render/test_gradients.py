"""Gradients of the whole renderer without bias: against finite differences, against quadrature, and none of the directions."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import textbook
import torch
from means import assert_same_mean
from stage import Stage
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.estimator import draw_samples, shade_samples
from ia_bench.render.gbuffer import SurfacePoints

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
    chosen = torch.randperm(len(tiny_stage.seen.pixel), generator=torch.Generator().manual_seed(0))[:PIXELS]
    points = tiny_stage.points(chosen)
    chosen = chosen[(points.normal * points.view).sum(-1) > 0.1]

    def run(leaves: Leaves, seed: int, repeats: int = REPEATS) -> Tensor:
        light, material = SampledLight.of(leaves["log_light"].exp(), uniform_fraction=0.1), Material(*list(leaves.values())[:2])
        return tiny_stage.estimate(chosen.repeat(repeats), material, light, SAMPLES, seed).radiance.reshape(repeats, len(chosen), 3)

    return run


def moves(leaf: Tensor) -> tuple[Tensor, Tensor]:
    """Two directions of change: everywhere the same, and random signs that are constant on a quarter along each axis."""
    signs = torch.randint(2, (4, 4, leaf.shape[2]), generator=torch.Generator().manual_seed(4)) * 2.0 - 1
    return torch.ones_like(leaf), signs.repeat_interleave(len(leaf) // 4, 0).repeat_interleave(leaf.shape[1] // 4, 1)


@pytest.mark.parametrize("name", STEPS)
def test_gradient_is_unbiased(leaves: Leaves, estimate: Estimate, name: str) -> None:
    """t-test of the gradient's mean against central differences of the estimate itself, along two directions.

    Both ends of a difference have the same random numbers, so their directions, densities, shadows and texels move with the
    parameter: all that the gradient, which holds them still, leaves out. The pixels are weighted at random. The gradient of
    the sum over all repeats is the sum of theirs.
    """
    step, found, expected = STEPS[name], [], []
    proxy = torch.rand(estimate(leaves, 0, 1)[0].shape, generator=torch.Generator().manual_seed(5))
    for move in moves(leaves[name]):
        slopes = []
        for repeat in range(REPEATS):
            leaf = leaves[name].clone().requires_grad_()
            (gradient,) = torch.autograd.grad((estimate({**leaves, name: leaf}, 100_000 + repeat, 1)[0] * proxy).sum(), leaf)
            slopes.append((gradient * move).double().sum())
        found.append(torch.stack(slopes))
        with torch.no_grad():
            high, low = (estimate({**leaves, name: leaves[name] + sign * step * move}, 2) for sign in (1, -1))
        expected.append(((high - low) * proxy).double().sum((1, 2)) / (2 * step))
    assert_same_mean(torch.stack(found, 1).numpy(), torch.stack(expected, 1).numpy(), resolution=0.05)


def surface_of(normal: torch.Tensor, view: torch.Tensor, uv: torch.Tensor) -> SurfacePoints:
    """Points at the origin, seen from the front."""
    front = torch.ones(len(normal), 1, dtype=torch.bool)
    return SurfacePoints(torch.zeros_like(normal), normal, view, uv, normal, front)


def test_detached_sampling_has_an_unbiased_gradient_of_roughness() -> None:
    """The mean of the gradient over 40 000 draws is the derivative of the integral, by quadrature and differences."""
    height, width, roughness, step = 4, 8, 0.5, 1e-3
    radiance = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(16)) ** 3
    normal, view = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([math.sin(0.8), 0.0, math.cos(0.8)])

    # Midpoint rule over the sphere in (cos theta, phi), whole cells in every texel, in float64.
    fine = 96
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    z = np.concatenate([a + (b - a) * (np.arange(fine) + 0.5) / fine for a, b in zip(edges[:-1], edges[1:], strict=True)])
    area = np.repeat((edges[:-1] - edges[1:]) / fine, fine) * (2 * np.pi / (width * fine))
    phi = np.pi - 2 * np.pi * (np.arange(width * fine) + 0.5) / (width * fine)
    sin = np.sqrt(1 - z**2)[:, None]
    grid = np.stack([sin * np.cos(phi), sin * np.sin(phi), np.broadcast_to(z[:, None], (len(z), len(phi)))], -1)
    light = np.repeat(np.repeat(radiance.double().numpy(), fine, 0), fine, 1)

    def integral(r: float) -> float:
        value = textbook.specular(normal.double().numpy(), view.double().numpy(), grid, r)
        return float((light.mean(-1) * value * area[:, None]).sum())

    expected = (integral(roughness + step) - integral(roughness - step)) / (2 * step)

    side, draws_each = 14, 200
    groups = side * side
    texture = torch.full((side, side, 1), roughness, requires_grad=True)
    count = groups * draws_each
    group = torch.arange(count) % groups
    uv = torch.stack([(group % side + 0.5) / side, (group // side + 0.5) / side], -1)
    sampler = SampledLight.of(radiance).sampler
    rotation = torch.rand(2, count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(17))
    points = surface_of(normal.repeat(count, 1), view.repeat(count, 1), uv)
    drawn = draw_samples(points, torch.ones(count, dtype=torch.bool), texture.detach(), sampler, rotation, points=1, count=4)
    specular = shade_samples(points, drawn, Material(torch.zeros(1, 1, 3), texture), radiance, "added", None).specular
    (gradient,) = torch.autograd.grad(specular.mean(-1).sum() / draws_each, texture)
    means = gradient.flatten().double()
    error = float(means.std()) / math.sqrt(groups)
    assert abs(expected) > 20 * error  # so that a wrong gradient is seen
    assert abs(float(means.mean()) - expected) < 4 * error
    value = specular.detach().mean(-1).double()
    assert abs(float(value.mean()) - integral(roughness)) < 4 * float(value.std()) / math.sqrt(count)


def test_directions_and_densities_carry_no_gradient(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """The diffuse part depends on roughness through the directions only, so its gradient of roughness is none."""
    roughness = tiny_material.roughness.clone().requires_grad_()
    material = Material(tiny_material.albedo, roughness)
    light = SampledLight.of(soft_light.clone().requires_grad_())
    assert not any(torch.is_tensor(table) and table.requires_grad for table in light.sampler)
    part = tiny_stage.estimate(torch.arange(50), material, light, 8, seed=18)
    (none,) = torch.autograd.grad(part.diffuse.sum(), roughness, retain_graph=True)
    assert float(none.abs().max()) == 0
    (gradient,) = torch.autograd.grad(part.specular.sum(), roughness)
    assert float(gradient.abs().sum()) > 0
    assert torch.isfinite(gradient).all()
