"""From a prior's sample of some views to what supervises the pixels of all."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Samples

NEAR_CEILING = 0.8
"""Share of the largest value that a prior can say from which a target means "at least": a mean of draws stays below it."""


@dataclass(frozen=True)
class Targets:
    """What the prior says of the G-buffer's P pixels.

    Attributes:
        values: (P, 3) per component: linear, premultiplied by coverage; zero in views that the prior was not asked about.
        weight: (P, 1), how much the pixel counts: even in the views that the prior was asked about, zero in others and where the
            photograph's mask leaves out what the mesh fills; mean 1, so that a loss keeps its weight however few views are asked.
        at_least: (P, 1) bool per component: where the prior could hardly have said more, a larger value is no error.
    """

    values: dict[str, Tensor]
    weight: Tensor
    at_least: dict[str, Tensor] = field(default_factory=dict)

    def to(self, device: torch.device) -> Targets:
        """The same on a device."""
        values, at_least = ({name: part.to(device) for name, part in parts.items()} for parts in (self.values, self.at_least))
        return Targets(values, self.weight.to(device), at_least)

    def state(self) -> dict[str, Any]:
        """For a checkpoint; ``Targets(**state)`` is the inverse."""
        return dict(vars(self))


def make_targets(problem: Problem, samples: Samples, views: tuple[int, ...]) -> Targets:
    """Targets from samples, or distilled estimates, of the ``views`` of the problem."""
    part, rows = restrict(problem.gbuffer, views)
    view = part.view()
    values, at_least = {}, {}
    for name, sample in sorted(samples.values.items()):
        value = sample.to(rows.device).reshape(-1, 3)[part.pixel]
        values[name] = _spread_over(problem, rows, value)
        if name in samples.ceilings:
            near = value.amax(-1) >= NEAR_CEILING * samples.ceilings[name].to(rows.device)[view]
            at_least[name] = _spread_over(problem, rows, near[:, None].float()) > 0
    asked = _spread_over(problem, rows, (~problem.photographs.left_out[rows, None]).float())
    return Targets(values, asked / asked.mean().clamp_min(1e-12), at_least)


def _spread_over(problem: Problem, rows: Tensor, values: Tensor) -> Tensor:
    """(P', C) values of the G-buffer's entries (P',) among zeros for all others: (P, C)."""
    everywhere = torch.zeros(len(problem.gbuffer.pixel), values.shape[-1], device=values.device)
    everywhere[rows] = values
    return everywhere
