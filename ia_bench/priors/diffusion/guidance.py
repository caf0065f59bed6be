"""Sampling toward a render: the paper's equation 8, and an implicit update in closed form.

Both rules turn the network's estimate of x_0 into a guided one, in the network's space (data in [-1, 1] unless it is latent).
Notation: y target, A operator, W weight, gamma strength, a = sqrt(alpha_bar_t), b = sqrt(1 - alpha_bar_t), e = A x_0(x_t) - y,
sums over one image. docs/sampling.md derives the scalings and measures each rule's bias.

"paper"     equation 8, eps <- eps + gamma grad_{x_t} phi, that is x_0 <- x_0 - gamma (b / a) J^T A W e / n, where J = dx_0 / dx_t
            is the network's Jacobian; norm "l2": phi = sqrt(e^T W e), n = phi; norm "squared": phi = e^T W e / 2, n = 1.
"variance"  argmin_x |x - x_0|^2 / r_t^2 + gamma (A x - y)^T W (A x - y): the estimate has variance r_t^2, the
            render 1 / gamma. For A = 1, W = 1: x_0 <- (x_0 / r_t^2 + gamma y) / (1 / r_t^2 + gamma). No step size, no stiffness.

The explicit rule, "paper", is stiff: its step grows without bound in gamma and in b / a. It is cut where it would carry A x_0 past
the minimum of |A x_0 - y| along the step (a line search that costs no evaluation), so the distance to the target never
grows. Every cut is counted in :class:`GuidanceReport`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.operators import GaussianBlur, cosine_transform, inverse_cosine_transform
from ia_bench.priors.diffusion.schedule import Denoise

Rule = Literal["paper", "variance"]
Norm = Literal["l2", "squared"]

DEFAULT_PRIOR_VARIANCE = 0.1
"""The variance of data in [-1, 1] given the photograph: a first prior's one-step estimate of albedo had 16 dB PSNR, so 4 x 10^-1.6.

Unconditional data spread evenly over [-1, 1] would have 1/3."""
SOLVER_TOLERANCE = 1e-4  # of the conjugate gradients, relative; 10^-4 of a pull is below half a step of 8 bits
SOLVER_STEPS = 200  # enough for that tolerance at condition number 1 + gamma r^2 = 1000, without any help of the preconditioner


@dataclass
class GuidanceReport:
    """``updates``: guided estimates so far, one per image and step. ``bounded``: how many of them had their step cut."""

    updates: int = 0
    _bounded: Tensor | int = 0

    @property
    def bounded(self) -> int:
        """Waits for the device: the count is kept there, so that counting stalls no step."""
        return int(self._bounded)

    @property
    def counters(self) -> dict[str, int]:
        """Both by name, as :class:`ia_bench.priors.contract.Samples` tells them."""
        return {"guided_estimates": self.updates, "guided_cut": self.bounded}

    def add(self, bounded: Tensor) -> None:
        """Count one step of a batch; ``bounded`` (N,) bool."""
        self.updates += len(bounded)
        self._bounded = self._bounded + bounded.sum()


@dataclass(frozen=True, eq=False)
class Pull:
    """One thing that samples are drawn to: ``operator`` of x_0 near ``target``.

    ``target`` (N, C, H, W) in the network's space; ``strength`` gamma >= 0; ``weight`` >= 0: None (1), (N, 1, H, W), or
    (N, C, H, W) where the channels differ.
    """

    target: Tensor
    strength: float
    weight: Tensor | None = None
    operator: GaussianBlur = field(default_factory=GaussianBlur)

    def __post_init__(self) -> None:
        if not (self.strength >= 0 and math.isfinite(self.strength)):
            raise InputError(f"guidance strength: expected a finite number >= 0, found {self.strength}")
        if self.target.ndim != 4:
            raise InputError(f"guidance target: expected shape (N, C, H, W), found {tuple(self.target.shape)}")
        expected = (self.target.shape[0], 1, *self.target.shape[2:])
        if self.weight is not None and tuple(self.weight.shape) not in (expected, tuple(self.target.shape)):
            raise InputError(f"guidance weight: expected shape {expected} or the target's, found {tuple(self.weight.shape)}")

    def through(self, remake: Callable[[Tensor], Tensor], scale: float = 1.0) -> Pull:
        """The same pull on images that were cut or resized by ``remake``; ``scale``: new pixels per old one."""
        weight = None if self.weight is None else remake(self.weight)
        return Pull(remake(self.target), self.strength, weight, GaussianBlur(self.operator.sigma * scale))

    def weighted(self, difference: Tensor) -> Tensor:
        """W times ``difference`` (N, C, H, W)."""
        return difference if self.weight is None else self.weight * difference


@dataclass(frozen=True, eq=False)
class Guidance(Pull):
    """A :class:`Pull` and the rule by which it acts; the module's docstring has the formulas.

    ``norm`` "l2" is the paper's; its gradient has length 1 whatever the image's size, so its strength counts in units of one
    image's distance. ``prior_variance``: see :func:`posterior_variance`; for the rule "variance". ``also``: further pulls that act
    together with this one. ``report``: counts what the guidance did; pass one to several guidances to add them up. Raises
    InputError for "l2" with "variance", whose two terms are both Gaussian.
    """

    rule: Rule = "variance"
    norm: Norm = "squared"
    prior_variance: float = DEFAULT_PRIOR_VARIANCE
    also: tuple[Pull, ...] = ()
    report: GuidanceReport = field(default_factory=GuidanceReport)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_norm(self.rule, self.norm, "guidance norm")

    @classmethod
    def of(cls, pulls: Sequence[Pull], rule: Rule, norm: Norm, prior_variance: float, report: GuidanceReport) -> Guidance:
        """The guidance of several ``pulls`` (at least one) at once."""
        first, *rest = pulls
        own = first.target, first.strength, first.weight, first.operator
        return cls(*own, rule, norm, prior_variance, tuple(rest), report)

    @property
    def active(self) -> bool:
        """Whether anything pulls at all."""
        return bool(self.pulls)

    @property
    def pulls(self) -> tuple[Pull, ...]:
        """This one and ``also``, those of strength 0 left out."""
        return tuple(pull for pull in (self, *self.also) if pull.strength > 0)

    def estimate_x0(self, denoise: Denoise, noisy: Tensor, t: int, alpha_bar: float) -> Tensor:
        """The guided estimate of x_0 (N, C, H, W) at ``noisy`` x_t, with one evaluation of ``denoise`` (not clipped)."""
        if self.rule == "variance":
            x0 = denoise(noisy, t)
            self.report.add(torch.zeros(len(x0), dtype=torch.bool, device=x0.device))
            return combine(x0, self.pulls, posterior_variance(self.prior_variance, alpha_bar))
        x0, direction = self._explicit_step(denoise, noisy, t, alpha_bar)
        return x0 - direction

    def _explicit_step(self, denoise: Denoise, noisy: Tensor, t: int, alpha_bar: float) -> tuple[Tensor, Tensor]:
        """The estimate of x_0 and what the explicit rule subtracts from it, cut to the line's minimum and counted."""
        with torch.enable_grad():
            variable = noisy.detach().requires_grad_()
            estimate = denoise(variable, t)
        if not estimate.requires_grad:
            raise InputError(
                'guidance rule "paper": expected a denoiser that can be differentiated, found an output without gradient '
                "(you may have called the network under torch.no_grad)"
            )
        x0 = estimate.detach()
        differences = [pull.operator.apply(x0) - pull.target for pull in self.pulls]
        gains = [self._gain(pull, difference) for pull, difference in zip(self.pulls, differences, strict=True)]
        slope = _normal(self.pulls, gains, differences)  # the gradient of all phi in x_0
        (direction,) = torch.autograd.grad(estimate, variable, slope)

        # Along x_0 - length * direction the sum of gain |A x - y|^2 / 2 is a parabola, lowest at slope / curvature.
        seen = [pull.operator.apply(direction) for pull in self.pulls]
        curvature = _inner(direction, _normal(self.pulls, gains, seen))
        lowest = torch.where(curvature > 0, _inner(direction, slope) / curvature, 0.0).clamp(min=0)
        length = math.sqrt((1 - alpha_bar) / alpha_bar) if alpha_bar > 0 else math.inf  # no signal left: to the line's minimum
        self.report.add((lowest < length) & direction.flatten(1).any(1))
        return x0, lowest.clamp(max=length)[:, None, None, None] * direction

    def _gain(self, pull: Pull, difference: Tensor) -> Tensor | float:
        """What multiplies W e: gamma / n, a number or (N, 1, 1, 1); 0 where an image has arrived and "l2" has no gradient."""
        if self.norm == "squared":
            return pull.strength
        distance = _inner(difference, pull.weighted(difference)).sqrt()
        return torch.where(distance > 0, pull.strength / distance, 0.0)[:, None, None, None]


def check_norm(rule: Rule, norm: Norm, key: str) -> None:
    """Raise InputError, naming ``key``, for "l2" with "variance", whose two terms are both Gaussian."""
    if rule == "variance" and norm != "squared":
        raise InputError(f'{key}: expected "squared" with the rule "variance", found {norm!r}')


def posterior_variance(prior_variance: float, alpha_bar: float) -> float:
    """r_t^2 = Var(x_0 | x_t) per value, at the noise level ``alpha_bar``: s^2 (1 - alpha_bar) / (s^2 alpha_bar + 1 - alpha_bar).

    ``prior_variance`` is s^2 > 0, the variance of x_0 given the condition alone; exact for a Gaussian prior.
    """
    return prior_variance * (1 - alpha_bar) / (prior_variance * alpha_bar + 1 - alpha_bar)


def combine(x0: Tensor, pulls: Sequence[Pull], variance: float) -> Tensor:
    """argmin_x |x - x0|^2 / ``variance`` + sum over ``pulls`` of gamma (A x - y)^T W (A x - y), (N, C, H, W).

    Closed form where no pull blurs. Otherwise preconditioned conjugate gradients on x - x0; the preconditioner replaces each
    channel's weight by its mean and inverts exactly in the cosine basis, so without weights the first step is the solution. An
    image stops when its own residual is below :data:`SOLVER_TOLERANCE`, so its result does not depend on the batch.
    """
    gains = [variance * pull.strength for pull in pulls]
    right = _normal(pulls, gains, [pull.target - pull.operator.apply(x0) for pull in pulls])
    if all(pull.operator.sigma == 0 for pull in pulls):
        weights = [1.0 if pull.weight is None else pull.weight for pull in pulls]
        return x0 + right / (1 + sum(gain * weight for gain, weight in zip(gains, weights, strict=True)))

    spectrum = torch.ones_like(x0[:, :1])
    for gain, pull in zip(gains, pulls, strict=True):
        mean = 1.0 if pull.weight is None else pull.weight.mean((2, 3), keepdim=True)
        spectrum = spectrum + gain * mean * pull.operator.eigenvalues(x0).square()

    change, residual = torch.zeros_like(x0), right
    step, previous = torch.zeros_like(x0), torch.ones_like(right[:, 0, 0, 0])
    goal = SOLVER_TOLERANCE**2 * _inner(right, right)
    for _ in range(SOLVER_STEPS):
        running = _inner(residual, residual) > goal
        if not bool(running.any()):
            break
        towards = inverse_cosine_transform(cosine_transform(residual) / spectrum)
        product = _inner(residual, towards)
        step = towards + torch.where(running, product / previous, 0.0)[:, None, None, None] * step
        image = step + _normal(pulls, gains, [pull.operator.apply(step) for pull in pulls])
        length = torch.where(running, product / _inner(step, image), 0.0)[:, None, None, None]
        change = change + length * step
        residual = residual - length * image
        previous = torch.where(running, product, 1.0)  # one that has arrived has 0 / 0 there
    return x0 + change


def _normal(pulls: Sequence[Pull], gains: Sequence[Tensor | float], differences: Sequence[Tensor]) -> Tensor:
    """The sum of gain A W d over ``pulls``: the gradient of their quadratic forms at differences ``d``."""
    parts = [
        pull.operator.apply(gain * pull.weighted(difference))
        for pull, gain, difference in zip(pulls, gains, differences, strict=True)
    ]
    return torch.stack(parts).sum(0) if len(parts) > 1 else parts[0]


def _inner(left: Tensor, right: Tensor) -> Tensor:
    """The inner product of each image, (N,)."""
    return (left * right).flatten(1).sum(1)
