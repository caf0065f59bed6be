"""Every extreme case, and that a case fails where it should."""

from __future__ import annotations

import math

import kernel_calls
import pytest
import torch
from stability import extreme_lights as lights
from stability import extreme_materials as materials
from stability import extreme_priors, extreme_rendering
from stability.case import Case, judge

from ia_bench.material import brdf

CASES = tuple(case for part in (materials, lights, extreme_rendering, extreme_priors) for case in part.cases())


@pytest.mark.stability
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.group}: {case.extreme}: {case.quantity}")
def test_the_answer_is_what_it_must_be(case: Case) -> None:
    assert judge(case) is None


def test_cases_have_names_of_their_own() -> None:
    assert len(CASES) >= 60
    assert len({(case.group, case.extreme, case.quantity) for case in CASES}) == len(CASES)
    assert {case.group for case in CASES} >= {"BRDF", "light", "rendering", "SSI", "guidance"}


def test_a_wrong_brdf_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 - (n.h)^2 taken literally loses the narrow lobes in float32."""

    def careless(normal: torch.Tensor, half: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
        cosine = brdf.dot(normal, half)
        return alpha**2 / (math.pi * (1 - cosine**2 + alpha**2 * cosine**2).clamp_min(1e-8) ** 2)

    monkeypatch.setattr(brdf, "ggx_ndf", careless)
    narrow = next(case for case in materials.cases() if "0.03, around" in case.extreme)
    assert judge(narrow) is not None


def test_a_wrong_light_sampler_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every draw lands one row too low."""
    sample = kernel_calls.sample_texel

    def low(sampler: lights.LatLongSampler, cell: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return (sample(sampler, cell, u) + sampler.width) % (sampler.height * sampler.width)

    monkeypatch.setattr(kernel_calls, "sample_texel", low)
    shares = next(case for case in lights.cases() if case.extreme == "one texel of 1e6" and "share" in case.quantity)
    assert judge(shares) is not None
