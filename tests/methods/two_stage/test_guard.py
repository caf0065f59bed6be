"""NaN and Inf in a fit: the step is skipped, named and counted, and the state stays finite (see also test_descent.py).

A renderer that misbehaves in chosen steps stands in for whatever may go wrong inside. Its first call is that of the initial
light, so call number n + 1 belongs to step n.
"""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_fit import Record, altered, fit, loaded
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings, LearningRates
from ia_bench.priors.contract import NoPrior
from ia_bench.render.renderer import PixelRadiance, Renderer

SETTINGS = FitSettings(stage1_steps=20, stage2_steps=10, pixels=64, solve_albedo=False)
ENTRY = 5  # of the batch, the one that is spoiled


class Failing:
    """A renderer that spoils a value of one step."""

    def __init__(self, renderer: Renderer, bad: int, value: float) -> None:
        self.surface, self.interreflection = renderer.surface, renderer.interreflection
        self._renderer, self._bad, self._value, self._step = renderer, bad, value, -2

    def render_pixels(self, gbuffer: Any, pixels: Tensor, *rest: Any, **options: Any) -> PixelRadiance:
        rendered = self._renderer.render_pixels(gbuffer, pixels, *rest, **options)
        self._step += 1
        specular = rendered.specular.clone()
        if self._step == self._bad:
            specular[ENTRY, 1] = self._value
        return replace(rendered, specular=specular)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_bad_pixel_costs_one_step_and_is_named(problem: Problem, value: float) -> None:
    failing, record = Failing(problem.renderer, 7, value), Record(every=0.0)
    found = fit(altered(problem, renderer=failing), NoPrior(), SETTINGS, record)
    assert all(bool(torch.isfinite(t).all()) for t in (found.material.albedo, found.material.roughness, found.light))
    assert found.counters["skipped_steps"] == 1
    assert record.notes == [
        "step 7 is skipped: the rendered radiance is NaN or Inf in 1 of 192 values, the first at [5, 1]",
        "fit: 1 of 30 steps were skipped because of NaN or Inf",
    ]
    assert [step for step, loss in enumerate(record.losses) if math.isnan(loss)] == [7]
    before, after = (loaded(record.states[step]) for step in (7, 8))
    for name, kept in before["parts"]["parameters"].items():
        assert torch.equal(kept, after["parts"]["parameters"][name])
    moments = [state["parts"]["texels"]["state"] for state in (before, after)]
    torch.testing.assert_close(*moments, rtol=0, atol=0)


def test_a_light_that_overflows_is_taken_back(problem: Problem) -> None:
    """exp(1000) is Inf in float32; the rate takes the log radiance there in one step, over and over."""
    settings = replace(SETTINGS, rates=LearningRates(light=1e3, final=1.0))
    with pytest.raises(FloatingPointError, match=r"^step 9: the light's radiance became NaN or Inf in \d+ of 1536 values"):
        fit(problem, NoPrior(), settings, record := Record(every=0.0))
    state = loaded(record.states[9])
    assert bool(torch.isfinite(torch.exp(state["parts"]["parameters"]["log_light"])).all())
