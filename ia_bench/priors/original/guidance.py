"""Guidance as the original code does it: the distance between render and estimate is measured in decoded images.

It is the paper's rule of :mod:`ia_bench.priors.diffusion.guidance` with the autoencoder's decoder D for an operator, and with
nothing differentiated through the network. With y the render, a = sqrt(alpha_bar_t), b = sqrt(1 - alpha_bar_t), strength gamma:

    phi = |D(x_0) - y|,   g = grad_{x_0} phi,   eps <- eps + gamma grad_{x_t} phi,   that is   x_0 <- x_0 - gamma (b / a^2) g

since the network is taken for constant in x_t. b / a^2 is 206 at the first of 200 levels and 0.04 at the last; where it is
large, the original's step carries the estimate far past the render, and only the short steps of x_t itself keep it in
bounds. Here, as for the other rules of this project, a step ends where phi would vanish if it were linear, at Polyak's
length phi / |g|^2, so that any strength stays finite; steps that were cut are counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.priors.diffusion.guidance import GuidanceReport


def pull(
    x0: Tensor, target: Tensor, decode: Callable[[Tensor], Tensor], strength: float, alpha_bar: float, report: GuidanceReport
) -> Tensor:
    """The estimate ``x0`` (N, C, h, w) drawn toward ``target`` (N, 3, S, S), the space of ``decode``; not clipped."""
    with torch.enable_grad():
        variable = x0.detach().requires_grad_()
        distance = (decode(variable) - target).flatten(1).norm(dim=1)
        (gradient,) = torch.autograd.grad(distance.sum(), variable)
    slope = gradient.flatten(1).square().sum(1)  # zero where the decoder is saturated, or the target reached
    longest = torch.where(slope > 0, distance.detach() / slope, 0.0)
    wanted = strength * math.sqrt(1 - alpha_bar) / alpha_bar
    report.add((longest < wanted) & (slope > 0))
    return x0 - longest.clamp(max=wanted)[:, None, None, None] * gradient
