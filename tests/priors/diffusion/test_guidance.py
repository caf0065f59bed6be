"""Guidance by the implicit rule, against dense linear algebra and exact posteriors.

For a Gaussian prior, DDIM is an affine map of its start noise. Run on every unit vector it gives the samples' mean and their
whole covariance to rounding, so only the error of the discretisation (first order in the step) lies between these and the
closed form, and no test of it is statistical. The ancestral sampler is tested statistically.
"""

import math

import numpy as np
import pytest
import torch
from guided import SIZE, affine_map, coupled, gaussian_denoiser, pulls_of, random, toward, wide_schedule
from scipy.fft import dctn
from scipy.integrate import solve_ivp
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ia_bench.priors.diffusion.guidance import Guidance, Pull, combine
from ia_bench.priors.diffusion.sampler import NoiseSchedule, SamplerSettings, sample


def blur_of(sigma: float) -> Pull:
    return Pull(torch.zeros(1, 1, *SIZE, dtype=torch.float64), 1.0, sigma=sigma)


def matrix_of(pull: Pull) -> Tensor:
    """A as a dense matrix, by applying it to every unit image."""
    count = math.prod(SIZE)
    return pull.blurred(torch.eye(count, dtype=torch.float64).reshape(count, 1, *SIZE)).reshape(count, count).T


def cosine_basis() -> Tensor:
    """Its columns are the orthonormal functions of the type-II cosine transform, after scipy."""
    count = math.prod(SIZE)
    return torch.from_numpy(dctn(np.eye(count).reshape(count, *SIZE), axes=(1, 2), norm="ortho").reshape(count, count))


# ----- operators --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sigma", [1.5, 4.0])
def test_blur_is_the_truncated_convolution_of_scipy(sigma: float):
    image = random(2, 3, 31, 37)
    expected = gaussian_filter(image.numpy(), (0, 0, sigma, sigma), mode="reflect", truncate=8)
    torch.testing.assert_close(blur_of(sigma).blurred(image), torch.from_numpy(expected), rtol=0, atol=2e-4)


def test_blur_is_symmetric_and_keeps_the_mean():
    image, matrix = random(1, 1, *SIZE), matrix_of(blur_of(2.0))
    torch.testing.assert_close(matrix, matrix.T)
    torch.testing.assert_close(blur_of(2.0).blurred(image).mean(), image.mean())
    assert blur_of(0.0).blurred(image) is image


@pytest.mark.parametrize(
    "kinds", [("identity",), ("weighted channel identity", "identity"), ("blur", "weighted identity"), ("weighted blur", "blur")]
)
@pytest.mark.parametrize("variance", [1e-6, 0.1, 10.0])
def test_implicit_update_solves_its_normal_equations(kinds: tuple[str, ...], variance: float):
    x0, pulls, count = random(2, 3, *SIZE, seed=1), pulls_of(*kinds), math.prod(SIZE)
    found = combine(x0, pulls, variance)
    for image in range(2):
        matrix, right = torch.eye(count, dtype=torch.float64) / variance, x0[image].reshape(3, count, 1) / variance
        for pull in pulls:
            blur = matrix_of(pull)
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
    pulls[0].weight[1] *= 0.01  # solved sooner than image 0
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
    blur = matrix_of(pull)
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


# ----- the explicit rule ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("norm", ["l2", "squared"])
@pytest.mark.parametrize("kind", ["identity", "weighted blur"])
def test_paper_rule_is_the_gradient_through_the_network(norm: str, kind: str):
    (pull,) = pulls_of(kind, strength=1e-3)
    pull = pull.through(lambda image: image[:1])
    guidance = Guidance((pull,), "paper", norm)
    noisy, level = random(1, 3, *SIZE, seed=5), 0.3

    def phi(point: Tensor) -> float:
        difference = pull.blurred(coupled(point, 0)) - pull.target
        total = float((difference * pull.weighted(difference)).sum())
        return math.sqrt(total) if norm == "l2" else total / 2

    gradient = torch.zeros_like(noisy)
    for i in range(noisy.numel()):
        nudge = torch.zeros_like(noisy)
        nudge.view(-1)[i] = 1e-5
        gradient.view(-1)[i] = (phi(noisy + nudge) - phi(noisy - nudge)) / 2e-5
    expected = coupled(noisy, 0) - pull.strength * math.sqrt((1 - level) / level) * gradient
    found = guidance.guiding(coupled, NoiseSchedule(torch.tensor([level])))(noisy, 0)
    assert guidance.cost == {"guided_estimates": 1, "guided_cut": 0}
    scale = float((expected - coupled(noisy, 0)).abs().max())
    assert float((found - expected).abs().max()) < 1e-5 * scale


@pytest.mark.parametrize(("norm", "strength"), [("squared", 1.0), ("squared", 100.0), ("l2", 1.0), ("l2", 30.0)])
@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_the_paper_rule_follows_its_differential_equation(norm: str, strength: float, sigma: float):
    """Whole paths from the same start noise, cut steps included, which end far from the posterior.

    With v = x_t / a: dv / d ln sigma = v - x_0(v). In the cosine basis, where a blur is diagonal, the guided x_0 is m - gain A e
    with e = A m - y, m = E[x_0 | v]; the cut ends where the sum of gain e^2 / 2 is least along A e.
    """
    mean, variance, count, basis = 0.2, 0.09, math.prod(SIZE), cosine_basis().numpy()
    target, init = random(1, 1, *SIZE, seed=20), random(3, 1, *SIZE, seed=21)
    goal, centre = basis.T @ target.flatten().numpy(), basis.T @ np.full(count, mean)
    eigen = np.diag(basis.T @ matrix_of(blur_of(sigma)).numpy() @ basis)

    def guided(level: float, v: np.ndarray) -> np.ndarray:
        share = variance / (variance + level**2)
        x0 = share * v + (1 - share) * centre
        error = eigen * x0 - goal
        step = eigen * error
        gain = strength * level * math.sqrt(1 + level**2) * share / (np.linalg.norm(error) if norm == "l2" else 1)
        return x0 - min(gain, step @ step / (eigen * step @ (eigen * step))) * step

    ends = []
    for start in init.reshape(3, count).numpy() @ basis * math.sqrt(1 + 1e8):
        limits = math.log(1e4), math.log(1e-4)
        ran = solve_ivp(lambda t, v: v - guided(math.exp(t), v), limits, start, "LSODA", rtol=1e-8, atol=1e-10)
        ends.append(torch.from_numpy(basis @ guided(1e-4, ran.y[:, -1])))
    expected, errors = torch.stack(ends), []
    guidance = toward(target.expand(3, 1, *SIZE), strength, sigma=sigma, rule="paper", norm=norm)
    for steps in (150, 300):
        schedule, settings, shape = wide_schedule(steps), SamplerSettings(steps, clip=None), (3, 1, *SIZE)
        denoise = guidance.guiding(gaussian_denoiser(schedule, mean, variance), schedule)
        found = sample(denoise, schedule, shape, lambda: init, settings, dtype=torch.float64).reshape(3, count)
        errors.append(float((found - expected).norm() / (expected - mean).norm()))
    assert errors[1] < 0.03
    assert errors[1] < 0.65 * errors[0] + 1e-3


@pytest.mark.parametrize("norm", ["l2", "squared"])
def test_steps_are_cut_where_the_distance_is_least_and_counted(norm: str):
    noisy, target = random(2, 3, *SIZE, seed=5), random(2, 3, *SIZE, seed=6)
    target[1] = coupled(noisy, 0)[1]  # has arrived: nothing to do, nothing to cut
    blur = blur_of(1.0).blurred
    goal, x0 = blur(target), coupled(noisy, 0)
    guidance = toward(goal, 1e6, sigma=1.0, rule="paper", norm=norm)
    found = guidance.guiding(coupled, NoiseSchedule(torch.tensor([0.5])))(noisy, 0)
    assert guidance.cost == {"guided_estimates": 2, "guided_cut": 1}
    torch.testing.assert_close(found[1], x0[1])
    step = found[0] - x0[0]
    distances = [float((blur(x0[0] + length * step) - goal[0]).norm()) for length in (0, 0.99, 1, 1.01)]
    assert distances[2] < min(distances[0], distances[1], distances[3])


COSINE = NoiseSchedule(torch.cos(torch.linspace(0.01, math.pi / 2, 1000, dtype=torch.float64)).square().clamp(min=1e-30))
ZERO_TERMINAL = NoiseSchedule(torch.cat([COSINE.alpha_bar[:-1], torch.zeros(1, dtype=torch.float64)]))


@pytest.mark.parametrize(("rule", "norm"), [("paper", "l2"), ("paper", "squared"), ("variance", "squared")])
def test_a_vanishing_strength_changes_nothing_where_no_signal_is_left(rule: str, norm: str):
    target, drawn = random(2, 3, *SIZE, seed=6).float(), []
    for strength in (0.0, 1e-6):
        guided = toward(target, strength, rule=rule, norm=norm).guiding(coupled, ZERO_TERMINAL)
        drawn.append(sample(guided, ZERO_TERMINAL, (2, 3, *SIZE), [0, 1], SamplerSettings(10)))
    torch.testing.assert_close(drawn[1], drawn[0], rtol=0, atol=1e-3)


@pytest.mark.parametrize("schedule", [COSINE, ZERO_TERMINAL])
@pytest.mark.parametrize(("rule", "norm"), [("paper", "l2"), ("paper", "squared"), ("variance", "squared")])
def test_every_strength_and_step_count_is_finite_and_in_range(schedule: NoiseSchedule, rule: str, norm: str):
    def rough(noisy: Tensor, t: int) -> Tensor:
        return 2 * torch.sin(5 * coupled(noisy, t))

    target, weight = random(2, 3, *SIZE, seed=6).float().clamp(-1, 1), random(2, 1, *SIZE).float().clamp(min=0)
    for steps, strengths in ((1, (1.0, 1000.0)), (10, (1.0, 1000.0)), (50, (1000.0,))):
        for strength in strengths:
            for blur, used in ((0.0, None), (2.0, weight)):
                guided = toward(target, strength, used, blur, rule=rule, norm=norm).guiding(rough, schedule)
                for eta in (0.0, 1.0):
                    found = sample(guided, schedule, (2, 3, *SIZE), [0, 1], SamplerSettings(steps, eta))
                    assert bool(found.isfinite().all())
                    assert float(found.abs().max()) <= 1
