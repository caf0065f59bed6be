"""Sampling toward a render: the paper's equation 8, and an implicit update in closed form.

Both rules turn the network's estimate of x_0 into a guided one, in the network's space (data in [-1, 1] unless it is latent).
Notation: y target, A operator, W weight, gamma strength, a = sqrt(alpha_bar_t), b = sqrt(1 - alpha_bar_t), e = A x_0(x_t) - y,
sums over one image. docs/sampling.md derives the scalings and measures each rule's bias.

"paper"     equation 8, eps <- eps + gamma grad_{x_t} phi, that is x_0 <- x_0 - gamma (b / a) J^T A W e / n, where J = dx_0 / dx_t
            is the network's Jacobian; norm "l2": phi = sqrt(e^T W e), n = phi; norm "squared": phi = e^T W e / 2, n = 1.
"variance"  argmin_x |x - x_0|^2 / r_t^2 + gamma (A x - y)^T W (A x - y): the estimate has variance r_t^2, the
            render 1 / gamma. For A = 1, W = 1: x_0 <- (x_0 / r_t^2 + gamma y) / (1 / r_t^2 + gamma). No step size, no stiffness.

The explicit rule, "paper", is stiff: its step grows without bound in gamma and in b / a. It is cut where it would carry x_0 past
the minimum of the sum of gamma e^T W e / n over all pulls along the step (a line search that costs no evaluation), so the distance
to one target, or the sum of those to several, never grows. Every cut is counted. At a = 0 an estimate of the noise, which equation
8 changes, says nothing of x_0, and the rule leaves x_0 as it is.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule

Rule = Literal["paper", "variance"]
Norm = Literal["l2", "squared"]

DEFAULT_PRIOR_VARIANCE = 0.1
"""The variance of data in [-1, 1] given the photograph: a first prior's one-step estimate of albedo had 16 dB PSNR, so 4 x 10^-1.6.

Unconditional data spread evenly over [-1, 1] would have 1/3."""
SOLVER_TOLERANCE = 2e-5  # of the conjugate gradients, relative; 10^-4 of a pull is below half a step of 8 bits
SOLVER_STEPS = 200  # enough for that tolerance at condition number 1 + gamma r^2 = 1000


@dataclass(frozen=True, eq=False)
class Pull:
    """One thing that samples are drawn to: A x_0 near ``target`` (N, C, H, W), in the network's space.

    A is a Gaussian blur of ``sigma`` >= 0 pixels over the last two axes; 0 is the identity. The image is continued by reflection
    (half-sample even), so A is symmetric, keeps the mean, and is diagonal in the type-II cosine transform: frequency k of n has
    eigenvalue exp(-(sigma pi k / n)^2 / 2). There is no kernel to truncate. ``strength`` gamma >= 0; ``weight`` >= 0: None (1),
    (N, 1, H, W), or (N, C, H, W) where the channels differ.
    """

    target: Tensor
    strength: float
    weight: Tensor | None = None
    sigma: float = 0.0

    def through(self, remake: Callable[[Tensor], Tensor], scale: float = 1.0) -> Pull:
        """The same pull on images that were cut or resized by ``remake``; ``scale``: new pixels per old one."""
        weight = None if self.weight is None else remake(self.weight)
        return Pull(remake(self.target), self.strength, weight, self.sigma * scale)

    def blurred(self, image: Tensor) -> Tensor:
        """A x for ``image`` (..., H, W), same shape; differentiable."""
        if self.sigma == 0:
            return image
        rows, columns = (_blur_matrix(size, self.sigma, image.device, image.dtype) for size in image.shape[-2:])
        return rows @ image @ columns

    def weighted(self, difference: Tensor) -> Tensor:
        """W times ``difference`` (N, C, H, W)."""
        return difference if self.weight is None else self.weight * difference


@dataclass(frozen=True, eq=False)
class Guidance:
    """What pulls samples, and the rule by which it acts; the module's docstring has the formulas.

    ``norm`` "l2" is the paper's; its gradient has length 1 whatever the image's size, so its strength counts in units of one
    image's distance. ``prior_variance``: see :func:`posterior_variance`; for the rule "variance". ``cost`` counts
    "guided_estimates", one per image and step, and "guided_cut", those of them whose step was cut. Raises InputError for "l2"
    with "variance", whose two terms are both Gaussian.
    """

    pulls: tuple[Pull, ...] = ()
    rule: Rule = "variance"
    norm: Norm = "squared"
    prior_variance: float = DEFAULT_PRIOR_VARIANCE
    cost: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        if self.rule == "variance" and self.norm != "squared":
            expected = 'expected "squared" with the rule "variance"'
            raise InputError(f"prior.options.guidance_norm: {expected}, found {self.norm!r}")

    def guiding(self, denoise: Denoise, schedule: NoiseSchedule) -> Denoise:
        """``denoise`` whose estimates are guided, with one evaluation each (not clipped); itself where nothing pulls."""
        pulls = [pull for pull in self.pulls if pull.strength > 0]
        if not pulls:
            return denoise

        def guided(noisy: Tensor, t: int) -> Tensor:
            self.cost["guided_estimates"] += len(noisy)
            alpha_bar = float(schedule.alpha_bar[t])
            if self.rule == "variance":
                return combine(denoise(noisy, t), pulls, posterior_variance(self.prior_variance, alpha_bar))
            if alpha_bar == 0:  # where b / a has no bound, so that any strength at all would go to the line's minimum
                return denoise(noisy, t)
            return self._explicit_step(denoise, pulls, noisy, t, alpha_bar)

        return guided

    def _explicit_step(self, denoise: Denoise, pulls: Sequence[Pull], noisy: Tensor, t: int, alpha_bar: float) -> Tensor:
        """The estimate of x_0 less what the explicit rule subtracts from it, which is cut to the line's minimum."""
        with torch.enable_grad():
            variable = noisy.detach().requires_grad_()
            estimate = denoise(variable, t)
        x0 = estimate.detach()
        differences = [pull.blurred(x0) - pull.target for pull in pulls]
        gains: list[Tensor | float] = [pull.strength for pull in pulls]  # gamma / n, what multiplies W e
        if self.norm == "l2":  # which has no gradient where an image has arrived
            n = [_inner(e, pull.weighted(e)).sqrt()[:, None, None, None] for pull, e in zip(pulls, differences, strict=True)]
            gains = [torch.where(one > 0, pull.strength / one, 0.0) for pull, one in zip(pulls, n, strict=True)]
        slope = _normal(pulls, gains, differences)  # the gradient of all phi in x_0
        (direction,) = torch.autograd.grad(estimate, variable, slope)

        # Along x_0 - length * direction the sum of gain |A x - y|^2 / 2 is a parabola, lowest at slope / curvature.
        curvature = _inner(direction, _normal(pulls, gains, [pull.blurred(direction) for pull in pulls]))
        lowest = torch.where(curvature > 0, _inner(direction, slope) / curvature, 0.0).clamp(min=0)
        length = math.sqrt((1 - alpha_bar) / alpha_bar)
        self.cost["guided_cut"] += int(((lowest < length) & direction.flatten(1).any(1)).sum())
        return x0 - lowest.clamp(max=length)[:, None, None, None] * direction


def posterior_variance(prior_variance: float, alpha_bar: float) -> float:
    """r_t^2 = Var(x_0 | x_t) per value, at the noise level ``alpha_bar``: s^2 (1 - alpha_bar) / (s^2 alpha_bar + 1 - alpha_bar).

    ``prior_variance`` is s^2 > 0, the variance of x_0 given the condition alone; exact for a Gaussian prior.
    """
    return prior_variance * (1 - alpha_bar) / (prior_variance * alpha_bar + 1 - alpha_bar)


def combine(x0: Tensor, pulls: Sequence[Pull], variance: float) -> Tensor:
    """argmin_x |x - x0|^2 / ``variance`` + sum over ``pulls`` of gamma (A x - y)^T W (A x - y), (N, C, H, W).

    Closed form where no pull blurs, otherwise conjugate gradients on x - x0. An image stops when its own residual is below
    :data:`SOLVER_TOLERANCE`, so its result does not depend on the batch.
    """
    gains = [variance * pull.strength for pull in pulls]
    right = _normal(pulls, gains, [pull.target - pull.blurred(x0) for pull in pulls])
    if all(pull.sigma == 0 for pull in pulls):
        weights = [1.0 if pull.weight is None else pull.weight for pull in pulls]
        return x0 + right / (1 + sum(gain * weight for gain, weight in zip(gains, weights, strict=True)))

    change, residual, step, square = torch.zeros_like(x0), right, right, _inner(right, right)
    goal = SOLVER_TOLERANCE**2 * square
    for _ in range(SOLVER_STEPS):
        running = square > goal
        if not bool(running.any()):
            break
        image = step + _normal(pulls, gains, [pull.blurred(step) for pull in pulls])
        length = torch.where(running, square / _inner(step, image), 0.0)[:, None, None, None]
        change, residual = change + length * step, residual - length * image
        former, square = square, torch.where(running, _inner(residual, residual), square)
        step = residual + torch.where(running, square / former, 0.0)[:, None, None, None] * step
    return x0 + change


def _normal(pulls: Sequence[Pull], gains: Sequence[Tensor | float], differences: Sequence[Tensor]) -> Tensor:
    """The sum of gain A W d over ``pulls``: the gradient of their quadratic forms at differences ``d``."""
    each = zip(pulls, gains, differences, strict=True)
    return torch.stack([pull.blurred(gain * pull.weighted(difference)) for pull, gain, difference in each]).sum(0)


def _inner(left: Tensor, right: Tensor) -> Tensor:
    """The inner product of each image, (N,)."""
    return (left * right).flatten(1).sum(1)


@functools.lru_cache(maxsize=32)
def _blur_matrix(size: int, sigma: float, device: torch.device, dtype: torch.dtype) -> Tensor:
    """C^T E C, of the orthonormal cosine transform C, whose row k is cos(pi k (i + 1/2) / size), and the eigenvalues E."""
    index = torch.arange(size, dtype=torch.float64)
    basis = torch.cos(math.pi / size * index[:, None] * (index + 0.5)) * math.sqrt(2 / size)
    basis[0] *= math.sqrt(0.5)
    eigenvalues = torch.exp(-0.5 * (sigma * math.pi / size * index).square())
    return (basis.T @ (eigenvalues[:, None] * basis)).to(device, dtype)
