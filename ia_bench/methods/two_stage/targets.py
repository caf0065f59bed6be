"""From a prior's samples to what supervises the pixels: several draws averaged, views fused, disagreement as weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.fusion import fuse_views
from ia_bench.methods.two_stage.losses import decode, encode
from ia_bench.methods.two_stage.settings import SupervisionSettings
from ia_bench.priors.contract import Prior

NEAR_CEILING = 0.8
"""Share of the largest value that a prior can say from which a target means "at least": a mean of draws stays below it."""


@dataclass(frozen=True)
class Targets:
    """What the prior says of the G-buffer's P pixels.

    ``values`` (P, 3) per component: linear, premultiplied by coverage; unless they were fused, zero in views that it was not
    asked about.
    ``weights`` (P, 1) per component: how much it counts there; mean 1, so that a loss keeps its weight however few views
    are asked. ``common_scale``: all views share one unknown scale of the albedo (they were fused); otherwise each has
    its own. ``at_least`` (P, 1) bool per component, where the prior could hardly have said more: a larger value is no error.
    """

    values: dict[str, Tensor]
    weights: dict[str, Tensor]
    common_scale: bool = False
    at_least: dict[str, Tensor] = field(default_factory=dict)

    def state(self) -> dict[str, Any]:
        """For a checkpoint; ``Targets(**state)`` is the inverse."""
        return {name: getattr(self, name) for name in ("values", "weights", "common_scale", "at_least")}


def make_targets(
    problem: Problem,
    prior: Prior,
    samples: Sequence[dict[str, Tensor]],
    views: tuple[int, ...],
    *,
    free_scale: bool,
    ceilings: Mapping[str, Tensor] | None = None,
) -> Targets:
    """Targets from K samples, each component -> (V', H, W, 3), of the views (V',) of the problem.

    The samples of a view are averaged in the prior's encoding, where its errors are even: a mean of linear values would
    be drawn to the bright ones. ``free_scale``: the loss ignores the scale of a view's albedo, so the draws are brought to
    one scale first, and neither their mean nor their spread is about it. Specular shading depends on the view and is not
    fused. ``ceilings``: component -> (V',), see :class:`ia_bench.priors.contract.Bounded`.
    """
    settings = problem.supervision
    part, rows = restrict(problem.gbuffer, views)
    view = part.pixel // (part.shape[1] * part.shape[2])
    values, weights, at_least = {}, {}, {}
    for name in sorted(prior.provides):
        drawn = torch.stack([sample[name].to(rows.device).reshape(-1, 3)[part.pixel] for sample in samples])
        if name == "albedo" and free_scale:
            drawn = to_one_scale(drawn, view, len(views))
        value, spread = average(drawn, prior.encoding[name])
        weight = _confidence(spread, settings)
        values[name] = _spread_over(problem, rows, value)
        weights[name] = _spread_over(problem, rows, weight)
        if name == "albedo" and settings.fuse:
            fused, spread, seen = fuse_views(
                problem, values[name], weights[name], prior.encoding[name], align=free_scale
            )
            values[name], weights[name] = fused, seen * _confidence(spread, settings)
        elif ceilings and name in ceilings:
            near = value.amax(-1) >= NEAR_CEILING * ceilings[name].to(rows.device)[view]
            at_least[name] = _spread_over(problem, rows, near[:, None].float()) > 0
        weights[name] = to_mean_one(weights[name])
    return Targets(values, weights, common_scale=settings.fuse, at_least=at_least)


def distilled_targets(problem: Problem, estimates: dict[str, Tensor], views: tuple[int, ...]) -> Targets:
    """Targets from denoised renders, component -> (V', H, W, 3), of a few views: equal weights there, none elsewhere."""
    part, rows = restrict(problem.gbuffer, views)
    values = {
        name: _spread_over(problem, rows, estimate.to(rows.device).reshape(-1, 3)[part.pixel])
        for name, estimate in sorted(estimates.items())
    }
    even = to_mean_one(_spread_over(problem, rows, torch.ones(len(rows), 1, device=rows.device)))
    return Targets(values, dict.fromkeys(values, even))


def to_one_scale(drawn: Tensor, view: Tensor, views: int) -> Tensor:
    """(K, P, 3) draws of pixels in views (P,), each view's scaled to the geometric mean of its K mean values."""
    if len(drawn) == 1:
        return drawn
    count = torch.zeros(views, device=view.device).index_add_(0, view, torch.ones_like(drawn[0, :, 0])).clamp_min(1)
    means = torch.stack([torch.zeros_like(count).index_add_(0, view, one.mean(-1)) / count for one in drawn])
    log = torch.log(means.clamp_min(1e-6))
    return drawn * torch.exp(log.mean(0) - log)[:, view, None]


def average(drawn: Tensor, encoding: str) -> tuple[Tensor, Tensor]:
    """Mean (P, 3) and standard deviation (P, 1; root mean square over the channels) of (K, P, 3) draws, in ``encoding``.

    The mean is returned linear. A single draw is its own mean to the bit, with no spread.
    """
    if len(drawn) == 1:
        return drawn[0], torch.zeros_like(drawn[0, :, :1])
    encoded = encode(drawn, encoding)
    return decode(encoded.mean(0), encoding), encoded.var(0).mean(-1, keepdim=True).sqrt()


def to_mean_one(weights: Tensor) -> Tensor:
    """Weights scaled to mean 1; all-zero ones stay zero."""
    return weights / weights.mean().clamp_min(1e-12)


def _confidence(spread: Tensor, settings: SupervisionSettings) -> Tensor:
    if settings.confidence == "none":
        return torch.ones_like(spread)
    return 1 / (1 + (spread / settings.spread_scale) ** 2)


def _spread_over(problem: Problem, rows: Tensor, values: Tensor) -> Tensor:
    """(P', C) values of the G-buffer's entries (P',) among zeros for all others: (P, C)."""
    everywhere = torch.zeros(len(problem.gbuffer.pixel), values.shape[-1], device=values.device)
    everywhere[rows] = values
    return everywhere
