"""The conformance check finds what is wrong: for every rule a prior that breaks it first.

Each broken prior is a small change of ``Sound``, which passes everything. A new rule needs a new entry in ``BROKEN``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from broken_priors import BROKEN, Offering, Sound, changed, spoiled
from torch import Tensor

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.finding import Finding
from ia_bench.checks.stack import Stack, painted_ball


@pytest.fixture(scope="module")
def ball() -> Stack:
    return painted_ball(20, 20, 3)


def failures(make: Callable[[], object], stack: Stack) -> list[Finding]:
    return [finding for finding in check_prior(make, stack) if finding.status == "fail"]


def test_sound_prior_passes_everything(ball: Stack) -> None:
    findings = list(check_prior(Sound, ball))
    assert {finding.status for finding in findings} == {"pass"}
    assert len({finding.what for finding in findings}) == len(findings)
    shown = {expected for _, expected in BROKEN.values()}
    never_broken = {f.what for f in findings} - shown
    # Lines without an entry of their own: the same rule as another line, for the other component or another image.
    assert never_broken == {"info", "albedo: premultiplied", "guided albedo", "37 x 31 images"}


def test_what_is_offered_besides_is_checked(ball: Stack) -> None:
    findings = list(check_prior(Offering, ball))
    assert {finding.status for finding in findings} == {"pass"}
    besides = [finding.what for finding in findings if finding.what not in {f.what for f in check_prior(Sound, ball)}]
    assert besides == [
        "specular: ceiling", "fingerprint", "distilled estimates", "distilled again", "a corrected fit",
        "corrected again", "one corrected on its own", "a sample with geometry", "the same geometry again",
    ]  # fmt: skip
    assert set(besides) == {expected for _, expected in BROKEN.values()} & set(besides)


@pytest.mark.parametrize("name", BROKEN)
def test_broken_prior_is_caught(name: str, ball: Stack) -> None:
    make, expected = BROKEN[name]
    found = failures(make, ball)
    assert found, "nothing failed"
    assert found[0].what == expected
    assert found[0].expected
    assert "\n" not in found[0].found


def test_nothing_that_a_prior_raises_gets_out(ball: Stack) -> None:
    def explode(*_: object, **__: object) -> None:
        raise SystemError("deep\ninside")

    findings = list(check_prior(changed(sample=lambda self, observations, *, seed, guidance=None: explode()), ball))
    assert [f.found for f in findings if f.status == "fail"] == ["SystemError: deep"]


def test_global_state_is_put_back(ball: Stack) -> None:
    deterministic = torch.are_deterministic_algorithms_enabled()
    torch.manual_seed(3)
    np.random.seed(3)
    expected = torch.rand(2), np.random.rand(2)
    torch.manual_seed(3)
    np.random.seed(3)
    list(check_prior(Sound, ball))
    assert torch.equal(torch.rand(2), expected[0])
    assert np.array_equal(np.random.rand(2), expected[1])
    assert torch.are_deterministic_algorithms_enabled() == deterministic


def test_not_guidable_is_never_guided(ball: Stack) -> None:
    def refuse(samples: dict, images: Tensor, masks: Tensor, seed: int, guidance: Mapping | None) -> None:
        assert guidance is None

    blind = type("Blind", (spoiled(refuse),), {"info": replace(Sound.info, guidable=False)})
    findings = list(check_prior(blind, ball))
    assert [finding.what for finding in findings if finding.status == "skip"] == ["guidance"]
    assert "fail" not in {finding.status for finding in findings}
