"""Guidance by the implicit rule, against dense linear algebra and exact posteriors.

For a Gaussian prior, DDIM is an affine map of its start noise. Run on every unit vector it gives the samples' mean and their
whole covariance to rounding, so only the error of the discretisation (first order in the step) lies between these and the
closed form, and no test of it is statistical. The ancestral sampler is tested statistically.
"""

from __future__ import annotations

import math

import pytest
import torch
from guided import SIZE, affine_map, gaussian_denoiser, pulls_of, random, toward, wide_schedule
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ia_bench.priors.diffusion.guidance import (
    GaussianBlur,
    Guidance,
    combine,
    cosine_transform,
    inverse_cosine_transform,
)
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample


def matrix_of(operator: GaussianBlur) -> Tensor:
    """A as a dense matrix, by applying it to every unit image."""
    count = math.prod(SIZE)
    return operator.apply(torch.eye(count, dtype=torch.float64).reshape(count, 1, *SIZE)).reshape(count, count).T


# ----- operators --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sigma", [1.5, 4.0])
def test_blur_is_the_truncated_convolution_of_scipy(sigma: float):
    image = random(2, 3, 31, 37)
    expected = gaussian_filter(image.numpy(), (0, 0, sigma, sigma), mode="reflect", truncate=8)
    torch.testing.assert_close(GaussianBlur(sigma).apply(image), torch.from_numpy(expected), rtol=0, atol=2e-4)


def test_blur_is_symmetric_keeps_the_mean_and_has_its_eigenvalues():
    blur, image = GaussianBlur(2.0), random(1, 1, *SIZE)
    matrix = matrix_of(blur)
    torch.testing.assert_close(matrix, matrix.T)
    torch.testing.assert_close(blur.apply(image).mean(), image.mean())
    spectrum = blur.eigenvalues(image) * cosine_transform(image)
    torch.testing.assert_close(inverse_cosine_transform(spectrum), blur.apply(image))
    assert GaussianBlur(0.0).apply(image) is image


KINDS = [
    ("identity",),
    ("weighted identity",),
    ("blur",),
    ("weighted blur",),
    ("weighted channel identity",),
    ("weighted channel blur", "identity"),
    ("weighted identity", "identity"),
    ("blur", "weighted identity"),
    ("weighted blur", "blur"),
]


@pytest.mark.parametrize("kinds", KINDS)
@pytest.mark.parametrize("variance", [1e-6, 0.1, 10.0])
def test_implicit_update_solves_its_normal_equations(kinds: tuple[str, ...], variance: float):
    x0, pulls, count = random(2, 3, *SIZE, seed=1), pulls_of(*kinds), math.prod(SIZE)
    found = combine(x0, pulls, variance)
    for image in range(2):
        matrix, right = torch.eye(count, dtype=torch.float64) / variance, x0[image].reshape(3, count, 1) / variance
        for pull in pulls:
            blur = matrix_of(pull.operator)
            weight = torch.ones_like(x0[image]) if pull.weight is None else pull.weight[image].expand_as(x0[image])
            weight, target = weight.reshape(3, count, 1), pull.target[image].reshape(3, count, 1)
            matrix = matrix + pull.strength * blur.T @ (weight * blur)
            right = right + pull.strength * blur.T @ (weight * target)
        expected = torch.linalg.solve(matrix, right).reshape(3, *SIZE)
        error = (found[image] - expected).norm() / (expected - x0[image]).norm()
        assert float(error) < 2e-3, f"relative error of the pull {float(error)}"


def test_implicit_update_does_not_depend_on_the_batch():
    """An image that went on iterating with its neighbour would move by about the solver's tolerance, 1e-4."""
    x0, pulls = random(2, 3, *SIZE, seed=1), pulls_of("weighted blur", "identity")
    pulls[0].weight[1] *= 0.01  # nearly solved by the preconditioner, unlike image 0
    together = combine(x0, pulls, 1.0)
    for i in range(2):
        alone = [pull.through(lambda image, i=i: image[i : i + 1]) for pull in pulls]
        torch.testing.assert_close(combine(x0[i : i + 1], alone, 1.0)[0], together[i], rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["identity", "weighted identity", "blur", "weighted blur"])
@pytest.mark.parametrize("strength", [1.0, 1000.0])
def test_variance_rule_samples_the_exact_posterior(kind: str, strength: float):
    """Mean and full covariance, from noise level 1e4 to 1e-4; halving the steps doubles what error there is."""
    mean, variance, count = 0.2, 0.09, math.prod(SIZE)
    (pull,) = pulls_of(kind, strength=strength)
    pull = pull.through(lambda image: image[:1, :1])
    guidance = Guidance((pull,), prior_variance=variance)
    blur = matrix_of(pull.operator)
    weight = torch.ones(count, dtype=torch.float64) if pull.weight is None else pull.weight.flatten()
    precision = torch.eye(count, dtype=torch.float64) / variance + strength * blur.T @ (weight[:, None] * blur)
    exact = torch.linalg.inv(precision)
    center = exact @ (mean / variance + strength * blur.T @ (weight * pull.target.flatten()))
    errors = []
    for steps in (150, 300):
        found_mean, found = affine_map(guidance, steps, mean, variance)
        assert float((found_mean - center).abs().max()) < 2e-3 * math.sqrt(variance)  # the start forgets sqrt(alpha_bar) mu
        errors.append(float((found - exact).norm() / exact.norm()))
    assert errors[1] < 0.05
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.12)


def test_variance_rule_with_ancestral_noise():
    """12 numbers at 4.5 standard errors: false alarm 8e-5; the discretisation takes up to 1 % of the variance (1000 steps)."""
    schedule, shape, mean, variance = wide_schedule(1000), (6, 3, 64, 64), 0.2, 0.09
    strengths = torch.tensor([0.0, 1.0, 10.0, 100.0, 300.0, 1000.0])
    target = torch.full(shape, -0.3)
    weight = strengths[:, None, None, None].expand(6, 1, 64, 64)
    guidance = toward(target, 1.0, weight, prior_variance=variance)
    settings, count = SamplerSettings(1000, eta=1.0, clip=None), 3 * 64 * 64
    found = sample(guidance.guiding(gaussian_denoiser(schedule, mean, variance), schedule), schedule, shape, range(6), settings)
    exact = 1 / (1 / variance + strengths)
    center = exact * (mean / variance - 0.3 * strengths)
    moments = found.flatten(1).mean(1), found.flatten(1).var(1)
    assert bool(((moments[0] - center).abs() < 4.5 * (exact / count).sqrt() + 1e-3 * exact.sqrt()).all()), moments[0] - center
    assert bool(((moments[1] / exact - 1).abs() < 4.5 * math.sqrt(2 / count) + 0.01).all()), moments[1] / exact


# ----- variances and errors ---------------------------------------------------------------------------------------------------
