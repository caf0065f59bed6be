"""From a prior's samples of some views to what they say of the pixels of all."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.methods.contract import PixelSamples, Problem
from ia_bench.methods.views import restrict
from ia_bench.priors.contract import Samples

NEAR_CEILING = 0.8
"""Share of the largest value that a prior can say from which a sample means "at least": a mean of draws stays below it."""


def pixel_samples(problem: Problem, samples: Samples, views: tuple[int, ...]) -> PixelSamples:
    """Samples, or distilled estimates, of the ``views`` of the problem."""
    part, rows = restrict(problem.gbuffer, views)
    view = part.view()
    values, at_least = {}, {}
    for name, sample in sorted(samples.values.items()):
        value = sample.to(rows.device).reshape(-1, 3)[part.pixel]
        values[name] = _among_zeros(problem, rows, value)
        if name in samples.ceilings:
            near = value.amax(-1) >= NEAR_CEILING * samples.ceilings[name].to(rows.device)[view]
            at_least[name] = _among_zeros(problem, rows, near[:, None].float()) > 0
    asked = _among_zeros(problem, rows, (~problem.photographs.left_out[rows, None]).float())
    return PixelSamples(values, asked / asked.mean().clamp_min(1e-12), at_least)


def _among_zeros(problem: Problem, rows: Tensor, values: Tensor) -> Tensor:
    """(P', C) values of the G-buffer's entries (P',) among zeros for all others: (P, C)."""
    everywhere = torch.zeros(len(problem.gbuffer.pixel), values.shape[-1], device=values.device)
    everywhere[rows] = values
    return everywhere
