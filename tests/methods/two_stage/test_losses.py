"""Variation against integrals, what each term must ignore and see, and that noise pulls the dual-buffer loss nowhere."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from means import assert_same_mean
from small_fit import TEXELS_ALONE, Record, altered, fit
from torch import Tensor

from benchmarks.reference import fetch
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.losses import PixelPairs, dual_buffer_loss, neighbouring_pixels, smoothness, total_variation
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import NoPrior
from ia_bench.render.renderer import PixelRadiance, Renderer
from ia_bench.scenes.color import linear_to_srgb, tone_map


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("threads", [1, 2])
def test_smoothness_and_its_gradient_by_torch(channels: int, threads: int) -> None:
    """In float64; pixels may come twice."""
    rng = torch.Generator().manual_seed(0)
    uv, index = torch.rand(3000, 2, generator=rng), torch.randint(3000, (3000, 2), generator=rng, dtype=torch.int32)
    neighbours = PixelPairs(index, torch.rand(3000, 2, generator=rng) * (torch.rand(3000, 2, generator=rng) < 0.8), uv)
    chosen = torch.randint(3000, (5000,), generator=rng)
    texture = torch.rand(9, 9, channels, generator=rng).requires_grad_()
    exact = texture.detach().double().requires_grad_()
    here, there = fetch(exact, uv.double()[chosen].repeat_interleave(2, 0)), fetch(exact, uv.double()[index[chosen].reshape(-1)])
    wanted = ((here - there).abs().mean(-1) * neighbours.similarity[chosen].reshape(-1)).mean()
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = smoothness(texture, neighbours, chosen)
        (gradient,) = torch.autograd.grad(3 * found, texture)
    finally:
        torch.set_num_threads(before)
    assert found.item() == pytest.approx(wanted.item(), rel=1e-5)
    (expected,) = torch.autograd.grad(3 * wanted, exact)
    torch.testing.assert_close(gradient.double(), expected, rtol=0, atol=1e-4 * float(expected.abs().max()))


def first_hits(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position (P, 3), triangle normal (P, 3) and UV (P, 2) of every pixel's first hit, from the mesh's own arrays."""
    mesh, gbuffer = problem.scene.mesh, problem.gbuffer
    face = gbuffer.face.numpy()
    rows, first = np.arange(len(face)), (face >= 0).argmax(1)
    corners = mesh.faces[face[rows, first]]
    u, v = gbuffer.barycentric.numpy()[rows, first].T.astype(np.float64)
    weights = np.stack([1 - u - v, u, v], 1)[..., None]
    triangle = mesh.vertices[corners].astype(np.float64)
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return (triangle * weights).sum(1), normal, (mesh.uv[corners] * weights).sum(1)


def test_neighbours_are_neighbours_in_space_whatever_the_atlas_says(problem: Problem) -> None:
    found = neighbouring_pixels(problem, problem.photographs.radiance, scale=0.1)
    position, normal, uv = first_hits(problem)
    np.testing.assert_allclose(found.uv.numpy(), uv, atol=1e-5)
    own = np.arange(len(position))
    index, similarity = found.index.numpy(), found.similarity.numpy()
    real = index != own[:, None]
    assert 0.5 < real.mean() < 1
    assert ((similarity >= 0) & (similarity <= 1)).all()
    assert (similarity[~real] == 0).all()

    # Exactly the next pixel to the right or below, of the same view.
    _, height, width = problem.gbuffer.shape
    pixel = problem.gbuffer.pixel.numpy()
    for side, step in ((0, 1), (1, width)):
        ours, other = pixel[real[:, side]], pixel[index[real[:, side], side]]
        assert (other == ours + step).all()
        assert (other // (height * width) == ours // (height * width)).all()
        assert side or (other // width == ours // width).all()

    # Near in space, and never around a fold or an edge of depth.
    away = np.linalg.norm(position[:, None] - position[index], axis=-1)[real]
    assert away.max() < 8 * np.median(away)
    assert (normal[:, None] * normal[index]).sum(-1)[real].min() > 0.3  # shading normals differ by less than triangles
    # Pairs reach across seams of the atlas, where a texture's own neighbours would not.
    apart = np.linalg.norm(uv[:, None] - uv[index], axis=-1)[real]
    across = apart > 10 * np.median(apart)
    assert across.sum() > 20


def test_similar_neighbours_are_smoothed_and_edges_are_not(problem: Problem) -> None:
    flat = torch.full((len(problem.gbuffer.pixel), 3), 0.4)
    found = neighbouring_pixels(problem, flat, scale=0.1)
    real = found.index != torch.arange(len(flat))[:, None]
    assert found.similarity[real].eq(1).all()
    left = problem.gbuffer.pixel % problem.gbuffer.shape[2] < 16
    painted = torch.where(left[:, None], 0.4, 4.0).expand(-1, 3)
    found = neighbouring_pixels(problem, painted, 0.1)
    across = left != left[found.index[:, 0]]
    assert across.sum() > 20
    assert float(found.similarity[across, 0].max()) < 1e-6
    assert neighbouring_pixels(problem, torch.zeros_like(flat), 0.1).similarity.isfinite().all()


# ---- two estimates that judge each other -----------------------------------------------------------------------------
def crossed(first: Tensor, second: Tensor, target: Tensor, cut: float) -> Tensor:
    """Of pixels that are all known."""
    return dual_buffer_loss(first, second, target, cut, torch.ones(len(target), 1, dtype=torch.bool))


def test_crossed_loss_without_noise_is_the_l1_beyond_its_cut_and_a_parabola_within() -> None:
    target = torch.tensor([[0.0, 0.05, 0.5], [1.0, 10.0, 1e6]])
    far = 3 * target + 1
    difference = (tone_map(far) - tone_map(target)).abs()
    assert crossed(far, far, target, 1e-6).item() == pytest.approx(difference.mean().item(), rel=1e-6)
    assert crossed(target, target, target, 0.1).item() == 0
    near = (target[:, 1:] * 1.001, target[:, 1:] * 1.002)
    values = [crossed(x, x, target[:, 1:], 0.1).item() for x in near]
    assert values[1] / values[0] == pytest.approx(4, rel=0.02)


def test_noise_pulls_the_l1_but_not_the_crossed_loss() -> None:
    """A pixel whose mean is right, the noise of its estimates in proportion to a parameter: the L1 wants less of it.

    Normal noise that the cut does not reach; the gradient's mean is within 4 of its standard errors (1 in 16 000).
    """
    generator = torch.Generator().manual_seed(0)
    target, count = torch.full((20_000, 1), 0.4), 20_000
    noise = 0.02 * torch.randn(2, count, 1, generator=generator)
    level = torch.ones(count, 1, requires_grad=True)
    loss = crossed(target + level * noise[0], target + level * noise[1], target, 0.5)
    (slope_of_both,) = torch.autograd.grad(loss * count, level)
    loss = (tone_map(target + level * noise.mean(0)) - tone_map(target)).abs().mean()
    (plain,) = torch.autograd.grad(loss * count, level)
    assert abs(slope_of_both.mean().item()) < 4 * slope_of_both.std().item() / count**0.5
    assert plain.mean().item() > 40 * plain.std().item() / count**0.5


def test_an_estimate_below_black_pulls_as_hard_as_one_at_its_target_and_blinding_pixels_finitely() -> None:
    """A control variate makes such estimates; at black the slope of the tone map is 12.9, at the target .27."""
    target = torch.tensor([[1.0]])
    slopes = []
    for value in (1.0, -0.5, -3.0):
        estimate = torch.tensor([[value]], requires_grad=True)
        crossed(estimate, target + 1, target, 0.1).backward()
        slopes.append(float(estimate.grad))
    assert slopes[0] > 0
    assert slopes[1:] == pytest.approx([slopes[0]] * 2)
    estimate = torch.tensor([[0.0, 1e6, 0.0]], requires_grad=True)
    loss = crossed(estimate, estimate.detach(), torch.tensor([[0.0, 0.0, 1e6]]), 0.1)
    (gradient,) = torch.autograd.grad(loss, estimate)
    assert bool(torch.isfinite(loss) & torch.isfinite(gradient).all())


@pytest.mark.parametrize("height", [16, 64])
def test_total_variation_is_the_mean_slope_over_the_sphere(height: int) -> None:
    """A log radiance a cos(polar angle) has the mean slope a pi / 4; a roof over the azimuth a, up and down, a pi / 2."""
    polar = ((torch.arange(height) + 0.5) * torch.pi / height)[:, None, None].expand(-1, 2 * height, 3)
    azimuth = ((torch.arange(2 * height) + 0.5) * torch.pi / height)[None, :, None].expand(height, -1, 3)
    assert total_variation(torch.full_like(polar, 3.0)).item() == 0
    assert total_variation(2 * polar.cos()).item() == pytest.approx(2 * torch.pi / 4, rel=0.02)
    roof = 2 * (azimuth - torch.pi).abs()
    assert total_variation(roof).item() == pytest.approx(2 * torch.pi / 2, rel=2 / height)
    assert total_variation(roof.roll(5, 1)).item() == pytest.approx(total_variation(roof).item(), rel=1e-5)


class NoisyRenderer(Renderer):
    """Shows every pixel the mean of the light, times a log-normal factor of mean 1, independent in every entry."""

    def render_pixels(self, gbuffer: Any, pixels: Tensor, *rest: Any, **_: Any) -> PixelRadiance:
        _material, light, _samples, generator = rest
        noise = torch.exp(NOISE * torch.randn(len(pixels), 1, generator=generator) - NOISE**2 / 2)
        value = light.radiance.mean((0, 1)) * noise
        return PixelRadiance(value, torch.zeros_like(value), torch.full_like(value, 0.5))


NOISE, STEPS, PIXELS = 0.5, 400, 512


def slope(radiance: np.ndarray) -> np.ndarray:
    """That of the tone map, the sRGB curve of log(1 + radiance)."""
    step = 1e-5 * (1 + radiance)
    up, down = (linear_to_srgb(np.log1p(at)) for at in (radiance + step, np.maximum(radiance - step, 0)))
    return (up - down) / (step + np.minimum(step, radiance))


@pytest.mark.verify
def test_gradient_of_a_step_is_of_independent_halves(problem: Problem, record: Record, monkeypatch: pytest.MonkeyPatch) -> None:
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
    settings = FitSettings(stage1_steps=STEPS, stage2_steps=0, pixels=PIXELS, guided=False, residual_cut=0.1)
    # The optimisers of other steps have no light of their own to look at.
    settings = replace(settings, rates=replace(settings.rates, scale_ambiguity=0.0), multigrid_rates=TEXELS_ALONE)
    noisy = NoisyRenderer(problem.renderer.surface, problem.renderer.rays)
    fit(altered(problem, renderer=noisy), NoPrior(), settings, record)
    assert len(gradients) == STEPS
    light = lights[0]
    assert all(torch.equal(light, other) for other in lights)

    images = problem.photographs.radiance.double().numpy()
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
