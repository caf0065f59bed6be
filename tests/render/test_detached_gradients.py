"""Gradients with the samples held: against finite differences, against quadrature, and none of the directions.

Without bias over whole fits' steps: test_gradients.py; of the kernels against torch: test_kernels.py.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from stage import Stage

from benchmarks import reference
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.render.estimator import draw_samples, shade_samples
from ia_bench.render.gbuffer import SurfacePoints

pytestmark = pytest.mark.verify


def surface_of(normal: torch.Tensor, view: torch.Tensor, uv: torch.Tensor) -> SurfacePoints:
    """Points at the origin, seen from the front."""
    front = torch.ones(len(normal), 1, dtype=torch.bool)
    return SurfacePoints(torch.zeros_like(normal), normal, view, uv, normal, front)


def test_gradients_against_finite_differences_with_the_samples_held() -> None:
    """gradcheck in float64: albedo, roughness and log radiance, the directions and weights of one draw fixed.

    By torch; the gradients of the kernels are compared with these in test_kernels.py.
    """
    generator = torch.Generator().manual_seed(13)
    count, height, width = 6, 3, 6
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * torch.randn(count, 3, generator=generator), dim=-1)
    uv = torch.rand(count, 2, generator=generator)
    albedo, roughness = torch.rand(3, 3, 3, generator=generator), 0.2 + 0.7 * torch.rand(3, 3, 1, generator=generator)
    log_light = torch.randn(height * width, 3, generator=generator)
    light = SampledLight.of(log_light.exp().reshape(height, width, 3))
    draws = torch.rand(2, count, 8, 3, dtype=torch.float64, generator=generator)
    direction, texel, weight = reference.sample_directions(normal, view, fetch(roughness, uv), *draws, light.sampler)
    fixed = [t.double() for t in (normal, view, uv, direction)]

    def shade(albedo: torch.Tensor, roughness: torch.Tensor, log_light: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return reference.shade_directions(*fixed, texel, weight.double(), albedo, roughness, log_light.exp())

    inputs = tuple(t.double().requires_grad_() for t in (albedo, roughness, log_light))
    assert torch.autograd.gradcheck(shade, inputs, rtol=1e-4, atol=1e-6)


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
        alpha2, cos_i, cos_o = r**4, np.maximum(grid[..., 2], 1e-9), math.cos(0.8)
        half = grid + view.double().numpy()
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        ggx = alpha2 / (np.pi * (half[..., 2] ** 2 * (alpha2 - 1) + 1) ** 2)
        smith = 2 / (np.sqrt(1 + alpha2 * (1 / cos_i**2 - 1)) + math.sqrt(1 + alpha2 * (1 / cos_o**2 - 1)))
        fresnel = 0.04 + 0.96 * (1 - half @ view.double().numpy()) ** 5
        value = ggx * smith * fresnel / (4 * cos_o) * (grid[..., 2] > 0)
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
    _, specular, _, _ = shade_samples(points, drawn, Material(torch.zeros(1, 1, 3), texture), radiance, "added", None)
    (gradient,) = torch.autograd.grad(specular.mean(-1).sum() / draws_each, texture)
    means = gradient.flatten().double()
    error = float(means.std()) / math.sqrt(groups)
    assert abs(expected) > 20 * error  # so that a wrong gradient is seen
    assert abs(float(means.mean()) - expected) < 4 * error
    value = specular.detach().mean(-1).double()
    assert abs(float(value.mean()) - integral(roughness)) < 4 * float(value.std()) / math.sqrt(count)


def test_directions_carry_no_gradient(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """The diffuse part depends on roughness through the directions only, so its gradient of roughness is none."""
    roughness = tiny_material.roughness.clone().requires_grad_()
    material = Material(tiny_material.albedo, roughness)
    pixels = torch.arange(50)
    part = tiny_stage.renderer().render_pixels(
        tiny_stage.gbuffer, pixels, material, SampledLight.of(soft_light), 8, torch.Generator().manual_seed(18)
    )
    (none,) = torch.autograd.grad(part.diffuse.sum(), roughness, retain_graph=True)
    assert float(none.abs().max()) == 0
    (gradient,) = torch.autograd.grad(part.specular.sum(), roughness)
    assert float(gradient.abs().sum()) > 0
    assert torch.isfinite(gradient).all()
