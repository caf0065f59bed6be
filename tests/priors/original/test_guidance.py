"""The guided step against the original's formula written down in its own variables, and its behaviour where it is stiff."""

from __future__ import annotations

import math
from collections import Counter

import pytest
import torch
from torch import Tensor

from ia_bench.priors.original import pull


def decoder(latents: Tensor) -> Tensor:
    """Something smooth, not linear, from (N, 2, 3, 3) to (N, 3, 4, 4) in [0, 1]."""
    generator = torch.Generator().manual_seed(5)
    matrix = torch.randn(18, 48, generator=generator, dtype=torch.float64) / 4
    return torch.sigmoid(latents.flatten(1).double() @ matrix).unflatten(1, (3, 4, 4))


def draws(*shape: int, seed: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("alpha_bar", [0.0048, 0.3, 0.998])
def test_small_strengths_are_the_original_step(alpha_bar: float) -> None:
    """There: eps' = eps + gamma d/dx_t |D((x_t - b eps) / a) - y|, with eps held constant, and x_0 from eps'."""
    a, b, gamma = math.sqrt(alpha_bar), math.sqrt(1 - alpha_bar), 1e-3
    noisy, eps, target = draws(4, 2, 3, 3, seed=1), draws(4, 2, 3, 3, seed=2), torch.sigmoid(draws(4, 3, 4, 4, seed=3))
    noisy.requires_grad_()
    distance = torch.stack([torch.linalg.norm(one) for one in decoder((noisy - b * eps) / a) - target])
    (score,) = torch.autograd.grad(distance.sum(), noisy)
    expected = ((noisy - b * (eps + gamma * score)) / a).detach()
    cost = Counter()
    found = pull(((noisy - b * eps) / a).detach(), target, decoder, gamma, alpha_bar, cost)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)
    assert cost == {"guided_estimates": 4, "guided_cut": 0}
    assert not found.requires_grad


@pytest.mark.parametrize("strength", [3.0, 1000.0, 1e30])
def test_long_steps_end_where_a_linear_decoder_reaches_the_render(strength: float) -> None:
    cost = Counter()
    x0, target = draws(3, 3, 4, 4, seed=1), draws(3, 3, 4, 4, seed=2)
    guided = pull(x0, target, lambda latents: 0.5 * latents, strength, 1e-4, cost)  # b / a^2 = 10^4
    torch.testing.assert_close(0.5 * guided, target, rtol=1e-9, atol=1e-9)
    assert cost == {"guided_estimates": 3, "guided_cut": 3}
